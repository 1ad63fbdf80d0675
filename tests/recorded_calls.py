"""A library function that keeps what a command hands it, and the text that the command prints."""

from dataclasses import dataclass, field
from typing import Any

import pytest

from gfp_grasp.cli import main


@dataclass
class Recorder:
    """Stands for a function: keeps its calls and gives the same answer each time."""

    answer: Any = None
    calls: list[tuple[tuple[Any, ...], dict[str, Any]]] = field(default_factory=list)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        self.calls.append((arguments, named))
        return self.answer

    @property
    def only(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """Arguments of the only call."""
        (call,) = self.calls
        return call


def recorded(patch: pytest.MonkeyPatch, name: str, answer: Any = None) -> Recorder:
    """Put a recorder in the place of a function, by its dotted name."""
    recorder = Recorder(answer)
    patch.setattr(name, recorder)
    return recorder


def run(words: str, *more: object) -> int:
    """Exit code of the program, run in this process; the words are split at blanks."""
    with pytest.raises(SystemExit) as stop:
        main([*words.split(), *map(str, more)])
    return int(stop.value.code or 0)


def rows_of(printed: str) -> list[str]:
    """Lines of printed tables below their headings, without their border and with the blanks that align them."""
    return [line.strip("│").removeprefix(" ").removesuffix(" ") for line in printed.split("\n") if line[:1] == "│"]
