"""Functions of the user's own, by name."""

import pytest

from gfp_grasp.errors import InvalidOption, UnknownCompleter
from gfp_grasp.plugins import imported_function


def imported(name: str, error=InvalidOption):
    return imported_function(name, what="planner", of="a completion", on_offer="first, second", error=error)


def test_a_function_is_found_by_its_module_and_name():
    assert imported("os.path:join") is __import__("os").path.join


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("third", "there is no planner 'third'"),
        ("os.path:", "there is no planner"),
        (":join", "there is no planner"),
        ("", "there is no planner ''"),
        ("no.such.module:f", "cannot be imported.*No module named 'no'"),
        ("os.path:no_such", "cannot be imported.*no_such"),
        ("..:f", "cannot be imported"),
        ("os.path:sep", "is a str, not a function of a completion"),
    ],
)
def test_whatever_is_no_function_is_refused_with_what_is_on_offer(name: str, said: str):
    for error in (InvalidOption, UnknownCompleter):
        with pytest.raises(error, match=said) as raised:
            imported(name, error)
        if "not a function" not in said:
            assert "first, second, or package.module:function" in str(raised.value)
