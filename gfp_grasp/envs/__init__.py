"""The gymnasium environment `GfpGrasp-v0`, and the grasp trial that it runs."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gfp_grasp.envs.grasp_env import GfpGraspEnv
    from gfp_grasp.envs.settings import TrialSettings
    from gfp_grasp.envs.trial import run_trial

__all__ = ["GfpGraspEnv", "TrialSettings", "run_trial"]

_HOMES = {"GfpGraspEnv": "grasp_env", "TrialSettings": "settings", "run_trial": "trial"}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
