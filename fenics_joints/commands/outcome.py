"""The outcome of a command, for the command line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from rich.console import Console

    from fenics_joints.report.document import Document
    from fenics_joints.report.html import DocumentPage

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Outcome(Generic[Result]):
    """A result and its document; nothing is written before it is asked for.

    Attributes:
        result: The result.
        document: The document of the result.
        failure: Why the result must not be used: the command ends with this error, after all is
            written; None for a valid result.
    """

    result: Result
    document: Document
    failure: str | None = None

    def __repr__(self) -> str:
        return f"Outcome({self.result!r})"

    def json(self) -> dict[str, object]:
        """The content of the JSON file. Called on every rank."""
        return self.document.data()

    def page(self, notes: Sequence[str] = ()) -> DocumentPage:
        """The page, with what is unusual in the case. Collective."""
        from fenics_joints.report.document import OnPage, Remarks
        from fenics_joints.report.html import DocumentPage

        unusual = OnPage([Remarks("Unusual in the case", notes, id="unusual")])
        return DocumentPage.of(replace(self.document, blocks=[unusual, *self.document.blocks]))

    def summary(self, console: Console) -> None:
        """Print it on one screen. Called on rank 0."""
        from fenics_joints.report.terminal import show

        show(console, self.document)
