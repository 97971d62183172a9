"""What every command hands to the command line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeVar

from rich.console import Console

if TYPE_CHECKING:
    from fenics_joints.report.document import Document

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Outcome(Generic[Result]):
    """What a command made of a case, and how it is written; nothing is written before it is called.

    Attributes:
        result: What was found.
        json: Makes the content of the JSON file. Called on every rank.
        page: Makes the page of HTML. Called on every rank; what rank 0 makes is written.
        summary: Prints one screen. Called on rank 0.
        failure: Why the result may not be used, where it is none: the command ends with this error,
            after all is written; None for a result.
    """

    result: Result
    json: Callable[[], dict[str, object]] = field(repr=False)
    page: Callable[[], str] = field(repr=False)
    summary: Callable[[Console], None] = field(repr=False)
    failure: str | None = None

    @classmethod
    def said(cls, result: Result, document: Document, failure: str | None = None):
        """With a document that says everything."""
        from fenics_joints.report.html import as_page
        from fenics_joints.report.terminal import show

        return cls(
            result,
            document.data,
            lambda: as_page(document),
            lambda console: show(console, document),
            failure,
        )

    @classmethod
    def of(
        cls,
        result: Result,
        page: Callable[[Result], str],
        summary: Callable[[Console, Result], None],
        failure: str | None = None,
    ) -> Outcome[Result]:
        """With the result's own JSON, and a page and a summary that are made of the result."""
        return cls(
            result,
            result.to_json,
            lambda: page(result),
            lambda console: summary(console, result),
            failure,
        )
