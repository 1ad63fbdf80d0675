"""The gymnasium environment `GfpGrasp-v0`, and the grasp trial that it runs."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gfp_grasp.envs.config import EnvConfig, TrialSettings
    from gfp_grasp.envs.episode import Episode, Randomisation
    from gfp_grasp.envs.grasp_env import GfpGraspEnv
    from gfp_grasp.envs.margin import FRICTIONS, least_friction, octaves
    from gfp_grasp.envs.picture import shade
    from gfp_grasp.envs.spaces import ActionCode
    from gfp_grasp.envs.task import GraspTask
    from gfp_grasp.envs.trial import run_trial

_HOMES = {
    "ActionCode": "spaces",
    "EnvConfig": "config",
    "FRICTIONS": "margin",
    "Episode": "episode",
    "GfpGraspEnv": "grasp_env",
    "GraspTask": "task",
    "Randomisation": "episode",
    "TrialSettings": "config",
    "least_friction": "margin",
    "octaves": "margin",
    "run_trial": "trial",
    "shade": "picture",
}

__all__ = [
    "FRICTIONS",
    "ActionCode",
    "EnvConfig",
    "Episode",
    "GfpGraspEnv",
    "GraspTask",
    "Randomisation",
    "TrialSettings",
    "least_friction",
    "octaves",
    "run_trial",
    "shade",
]


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
