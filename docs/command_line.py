"""Prints docs/command_line.md, which is all that the program says of its commands: `make commands` writes it."""

import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import typer
from typer.models import CommandInfo

from gfp_grasp.cli.program import app

OPENING = """# The command line

`gfp-grasp COMMAND --help` says the same as this page, which is written by `make commands`. Arguments are in
capitals, and options that have no default and are not required can be left out.
"""
VALUES = {bool: "", int: "integer", float: "number", str: "text", Path: "path"}


def page() -> str:
    """The page as Markdown."""
    return "\n".join([OPENING, *_group(app, "gfp-grasp")])


def _group(group: typer.Typer, called: str) -> Iterator[str]:
    for command in group.registered_commands:
        yield from _command(command, called)
    for inner in group.registered_groups:
        assert inner.typer_instance is not None
        info = inner.typer_instance.info
        yield f"## {called} {info.name}\n\n{info.help}\n"
        yield from _group(inner.typer_instance, f"{called} {info.name}")


def _command(command: CommandInfo, called: str) -> Iterator[str]:
    assert command.callback is not None
    name = command.name or command.callback.__name__
    yield f"{'#' * (1 + len(called.split()))} {called} {name}\n\n{inspect.getdoc(command.callback)}\n"
    yield "| option | value | default | meaning |\n|---|---|---|---|"
    hints = get_type_hints(command.callback, include_extras=True)
    for parameter in inspect.signature(command.callback).parameters.values():
        kind, info = get_args(hints[parameter.name])
        option = _names(parameter.name, info, kind)
        cells = (option, _value(kind, info), _default(parameter.default), info.help)
        yield f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
    yield ""


def _names(name: str, info: Any, kind: Any) -> str:
    if isinstance(info, typer.models.ArgumentInfo):
        return f"`{name.upper()}`"
    given = f"--{name.replace('_', '-')}"
    # Typer keeps the first name of an annotated option where its default would be.
    declared = (info.default, *(info.param_decls or ())) if isinstance(info.default, str) else ()
    usual = f"{given}/--no-{given[2:]}" if kind is bool else given
    return ", ".join(f"`{word}`" for word in declared or (usual,))


def _value(kind: Any, info: Any) -> str:
    if NoneType in get_args(kind):
        kind, _ = get_args(kind)
    many = get_origin(kind) is list
    if many:
        (kind,) = get_args(kind)
    value = VALUES[kind] if info.dir_okay else "file"
    if info.exists:
        value += " that exists"
    if info.min is not None:
        value += f" from {info.min}" + ("" if info.max is None else f" to {info.max}")
    return value + (", any number of them" if many else "")


def _default(default: object) -> str:
    if default is inspect.Parameter.empty:
        return "required"
    if default is None or default is False or default == "":
        return ""
    return f"`{default.as_posix() if isinstance(default, Path) else default}`"


if __name__ == "__main__":
    sys.stdout.write(page().rstrip("\n") + "\n")
