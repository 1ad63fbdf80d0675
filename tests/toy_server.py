"""A server in viser's place: it keeps what is added to its scene and to its panel, and serves nothing."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.machinery import ModuleSpec
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest


class Handle:
    """What was added: its kind, what it was added with, and what was set since."""

    def __init__(self, kind: str, arguments: tuple[Any, ...], named: dict[str, Any]) -> None:
        self.kind, self.arguments, self.named = kind, arguments, named
        self.inside: list[Handle] = []
        self.removed, self.visible = False, True
        self.value = arguments[1] if kind == "checkbox" else arguments[4] if kind == "slider" else None
        self.content = arguments[0] if kind == "html" else None
        self.on: dict[str, Callable[[Any], Any]] = {}

    def on_update(self, act: Callable[[Any], Any]) -> None:
        self.on["update"] = act

    def on_click(self, act: Callable[[Any], Any]) -> None:
        self.on["click"] = act

    def remove(self) -> None:
        self.removed = True

    def __enter__(self) -> "Handle":
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Adder:
    """Has a method add_KIND for every kind; keeps the handles in order."""

    def __init__(self) -> None:
        self.added: list[Handle] = []
        self.set: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Callable[..., Handle | None]:
        def add(*arguments: Any, **named: Any) -> Handle | None:
            if not name.startswith("add_"):
                self.set[name] = arguments or named
                return None
            self.added.append(Handle(name.removeprefix("add_"), arguments, named))
            return self.added[-1]

        return add

    def named(self, kind: str) -> dict[str, Handle]:
        """Handles of one kind, by their first argument."""
        return {handle.arguments[0]: handle for handle in self.added if handle.kind == kind}


class ToyServer:
    """Scene, panel and camera of a page that nobody sees."""

    def __init__(self, *, host: str = "127.0.0.1", port: int = 0, label: str = "", verbose: bool = True) -> None:
        self.started_with = {"host": host, "port": port, "label": label, "verbose": verbose}
        self.scene: Any = Adder()
        self.gui: Any = Adder()
        self.initial_camera = SimpleNamespace()
        self.stopped = False
        print("started")  # noqa: T201 - as viser does

    @contextmanager
    def atomic(self) -> Iterator[None]:
        yield

    def get_host(self) -> str:
        return self.started_with["host"]

    def get_port(self) -> int:
        return self.started_with["port"]

    def stop(self) -> None:
        self.stopped = True
        print("stopped")  # noqa: T201


def put_toy_in_place_of_viser(patch: pytest.MonkeyPatch) -> None:
    """Whoever imports viser gets the toy."""
    module = ModuleType("viser")
    module.__spec__ = ModuleSpec("viser", None)
    module.ViserServer = ToyServer  # type: ignore[attr-defined]
    patch.setitem(sys.modules, "viser", module)
