"""The stable keys of ``diagnose --json``, as a schema; other keys may come and go."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class _Keys(BaseModel):
    model_config = ConfigDict(extra="allow")


class _Gap(_Keys):
    """Relative root mean square errors of frequencies; null where there is none."""

    before: float | None = Field(description="Of the nominal model.")
    after: float | None = Field(description="Of the leading hypothesis, fitted to all data.")
    heldout_before: float | None = Field(description="Of the nominal model on held-out data.")
    heldout_after: float | None = Field(description="Of the chosen hypothesis on them.")
    placebo_after: float | None = Field(description="Of the best wrong effect on them.")
    noise: float = Field(description="Of the measurement itself.")


class _Effect(_Keys):
    name: str = Field(description="What it is; 'no gap' and 'none of these' among them.")
    region: str = Field(description="Where it acts; empty if the name says so.")
    probability: float = Field(
        ge=0, le=1, description="That it is at work, over all hypotheses with it."
    )
    class_: str = Field(alias="class", description="Name of its class.")
    detectable: bool = Field(description="Whether the test sees it at its expected size.")


class _Class(_Keys):
    """Effects that the test cannot tell apart, or one that it can."""

    name: str
    effects: list[str] = Field(description="Keys of its members, 'name (region)'.")
    probability: float = Field(ge=0, le=1, description="That one of them at least is at work.")


class _Hypothesis(_Keys):
    """Effects that are at work together; hypotheses exclude one another."""

    label: str
    effects: list[str]
    probability: float = Field(ge=0, le=1)
    log_evidence: float
    p_value: float = Field(ge=0, le=1)
    parameters: list[dict[str, Any]] = Field(
        description="Rows with effect, name, value, low, high (68 %), unit, identified, nuisance."
    )


class _Outside(_Keys):
    """Causes outside the library, in simulated tests of the same structure and sensors."""

    prior: float = Field(ge=0, le=1, description="Their probability before the test.")
    rate: float = Field(
        ge=0, le=1, description="How often they are taken for effects of the library."
    )
    answers: int = Field(
        description="Answers given as 70 to 90 % in tests with the cause in the library."
    )
    right: int = Field(description="How many of these were right.")
    tests: int


class DiagnosisJson(_Keys):
    """What ``fenics-joints diagnose --json FILE`` writes."""

    version: str = Field(description="Of fenics-joints.")
    title: str
    verdict: Literal["cause", "likely", "no gap", "unknown", "ambiguous"]
    summary: str
    gap: _Gap
    effects: list[_Effect] = Field(description="The most probable first.")
    classes: list[_Class] = Field(description="The most probable first.")
    hypotheses: list[_Hypothesis] = Field(description="The most probable first; they sum to 1.")
    outside: _Outside | None = None
    in_words: dict[str, Any] | None = None


def json_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of `DiagnosisJson`; docs/diagnosis.schema.json has it."""
    found = DiagnosisJson.model_json_schema(by_alias=True)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **found}
