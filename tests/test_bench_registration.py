"""The bench of registrations measures what it says."""

import numpy as np
import pytest

from gfp_grasp.bench import RegistrationConfig, bench_registration
from gfp_grasp.bench.registration import _errors
from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.shapes import HOUSEHOLD
from gfp_grasp.train import render_views, shape_source
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import FittedPrimitive


def test_turn_and_shift_of_a_fit_are_its_errors() -> None:
    view, primitive = render_views(shape_source("mug", 7), num_views=1)[0], PrimitiveLibrary.shipped().primitive("mug")
    still = np.zeros(len(primitive.modes))
    right = _errors(FittedPrimitive(primitive, view.T_world_object, np.ones(3), still, 0.0), view, primitive)
    R = rotation_about(view.T_world_object[:3, 2], np.radians(30.0))
    about = make_T(R @ view.T_world_object[:3, :3], view.T_world_object[:3, 3] + (0.1, 0.0, 0.0))
    wrong = _errors(FittedPrimitive(primitive, about, np.ones(3), still, 0.0), view, primitive)
    assert right["axis_deg"] == pytest.approx(0.0, abs=1e-4)
    assert right["yaw_deg"] == pytest.approx(0.0, abs=1e-4)
    assert wrong["axis_deg"] == pytest.approx(0.0, abs=1e-4)
    assert wrong["yaw_deg"] == pytest.approx(30.0, abs=1e-4)
    assert wrong["offset_m"] > 0.05
    assert wrong["cd_m"] > right["cd_m"] + 0.05


@pytest.mark.slow
def test_every_class_is_fitted_and_counted() -> None:
    report = bench_registration(starts=("box",), config=RegistrationConfig(views=1, limit=1))
    rows = report["rows"]
    assert isinstance(rows, dict)
    assert set(rows) == {*HOUSEHOLD, "all"}
    assert rows["all"]["box"]["views"] == 20
    assert rows["cup"]["box"]["yaw_deg"] is None


def test_unknown_start_and_no_views_are_refused() -> None:
    with pytest.raises(InvalidOption, match="box"):
        bench_registration(starts=("luck",))
    with pytest.raises(InvalidOption, match="views"):
        RegistrationConfig(views=0)
