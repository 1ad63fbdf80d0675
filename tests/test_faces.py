"""What each room shows stands where its `__init__` says."""

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

import pytest

import gfp_grasp

ROOMS = sorted(room.name for room in iter_modules([str(Path(gfp_grasp.__file__).parent)]) if room.ispkg)
WITH_NAMES = [name for name in ROOMS if hasattr(import_module(f"gfp_grasp.{name}"), "__all__")]


def test_most_rooms_name_what_others_may_use():
    assert {"bench", "collision", "envs", "export", "parallel", "scenes", "score", "train"} <= set(WITH_NAMES)


@pytest.mark.parametrize("room", WITH_NAMES)
def test_every_name_of_a_room_is_there_and_is_what_it_is_called(room: str):
    module = import_module(f"gfp_grasp.{room}")
    assert len(set(module.__all__)) == len(module.__all__)
    for name in module.__all__:
        thing = getattr(module, name)
        if isinstance(thing, type) or (callable(thing) and hasattr(thing, "__code__")):
            own = getattr(thing, "__name__", name)
            assert own == name, f"{room} calls {own} {name}"
        assert not isinstance(thing, ModuleType)


@pytest.mark.parametrize("room", WITH_NAMES)
def test_a_name_that_no_room_has_is_an_attribute_error(room: str):
    module = import_module(f"gfp_grasp.{room}")
    assert not hasattr(module, "magic")
