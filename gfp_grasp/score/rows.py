"""One row of a score: one view of one object under one method, its best grasp tried in both worlds."""

from __future__ import annotations

import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice

import numpy as np

from gfp_grasp.completers import Oracle
from gfp_grasp.completion import Completion
from gfp_grasp.detect import upright_box
from gfp_grasp.envs import ActionCode, EnvConfig, Episode, GraspTask, octaves
from gfp_grasp.errors import GfpGraspError, InvalidOption, WorkerLost
from gfp_grasp.grasps import PLANNERS, GraspConfig, bearable_weight, get_planner, plan_grasps
from gfp_grasp.metrics import CompletionErrors, completion_errors
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.score.report import ScoreRow, method_names
from gfp_grasp.types import Detection, Grasp, Outcome, PointCloud, SupportPlane, TrueObject

# Errors of a user's own planner, which cost its own rows and no others.
_OF_USERS = (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
_UP = np.array([0.0, 0.0, 1.0])
_CODE = ActionCode()
_NO_GRASP = Outcome(False, "no_grasp_found", 0.0, 0.0, False)
# Many more tries than for a ranking: nothing found is to mean that there is nothing.
_THOROUGH = GraspConfig(num_rays=20_000, num_lines=2000, num_looks=16_000, num_poses=2400)
_MARGIN_TRIALS = 5
_MANY = 40  # grasps that are asked for the weight they bear
# Makers of grippers reckon the force of a friction grip with this factor for accelerations and uncertain friction.
_SAFETY = 2.0
_GRAVITY = 9.81
NO_GRIP, TOO_HEAVY = "no_grip", "too_heavy"


@dataclass(frozen=True, kw_only=True)
class ScoreConfig:
    """Which objects are scored, and on how many views and grasps of each.

    Attributes:
        views: Number of views of each object.
        grasps: Number of the best grasps that are tried until one holds; the first alone is the score.
        seed: Seed of poses, views, noise and planning.
        split: Split of procedural families: train, val or test.
        clutter: Number of other objects, from the same choice, that stand around each object.
        limit: Most objects to score; None scores all.
        classes: Classes whose objects are scored; None takes those that have a primitive and objects of unknown class,
            ("*",) takes all.
        gps: Folders of primitives of your own, as the environment's option takes them.
        detector: Name of what finds the object in the picture, see `gfp_grasp.detect.get_detector`.
    """

    views: int = 4
    grasps: int = 5
    seed: int = 0
    split: str = "test"
    clutter: int = 0
    limit: int | None = None
    classes: tuple[str, ...] | None = None
    gps: str = ""
    detector: str = "tabletop"

    def __post_init__(self) -> None:
        limit = 1 if self.limit is None else self.limit
        for count, what in ((self.views, "views"), (self.grasps, "grasps"), (limit, "limit")):
            if count < 1:
                raise InvalidOption(f"{what} is {count}; at least 1 is expected")
        if self.clutter < 0:
            raise InvalidOption(f"clutter is {self.clutter}; zero or more is expected")

    def wanted(self) -> set[str]:
        """Classes whose objects are scored, "" for unknown ones."""
        return {*PrimitiveLibrary.from_option(self.gps).categories, ""} if self.classes is None else set(self.classes)


@dataclass(frozen=True)
class RowJob:
    """Seeds and names that a row is made from; picklable.

    Attributes:
        objects: Families, file or folder, as `scenes.load_objects` takes them.
        number: Number of the object among them.
        object_name: Name of the object.
        method: Name of the completer, and behind a slash the planner's, if it is not `antipodal`.
        view: Number of the view.
        config: Settings of the whole score.
    """

    objects: str
    number: int
    object_name: str
    method: str
    view: int
    config: ScoreConfig

    @property
    def episode_seed(self) -> int:
        """Seed of the view, the same for every method, whatever else is scored."""
        entropy = [self.config.seed, zlib.crc32(self.object_name.encode()), self.view]
        return int(np.random.SeedSequence(entropy).generate_state(1)[0])


def hindrance(truth: TrueObject) -> str:
    """Why the gripper cannot carry an object as it stands, whatever is known of it: NO_GRIP, TOO_HEAVY, or "".

    A jug that is wider everywhere than the jaws open tells nothing about a completion, and neither does a full pot that
    no grasp carries: at the middle of the environment's frictions and forces, none of many grasps on the true mesh
    bears twice its weight.
    """
    points = np.asarray(truth.mesh.vertices)
    detection = Detection(PointCloud(points), _UP, SupportPlane(_UP, 0.0), "", {}, upright_box(points, _UP))
    known = Oracle()(detection, truth.mesh, truth.collision)
    drawn = EnvConfig()
    friction, grip_n = (drawn.friction_min + drawn.friction_max) / 2, (drawn.grip_min_n + drawn.grip_max_n) / 2
    found: tuple[Grasp, ...] = ()
    for config in (GraspConfig(), _THOROUGH):
        found = plan_grasps(known, _MANY, config=config) or found
        borne = bearable_weight(known, found, friction=friction, grip_n=grip_n)
        if (borne >= _SAFETY * _GRAVITY * truth.mass_kg).any():
            return ""
    return TOO_HEAVY if found else NO_GRIP


def make_row(job: RowJob) -> ScoreRow:
    """Make a row from its seeds: the same job gives the same row, but for its timings."""
    config = job.config
    started = time.perf_counter()
    task = task_of(job.objects, config, method_names(job.method)[0])
    episode = task.draw(np.random.default_rng(job.episode_seed), number=job.number)
    completed_at = time.perf_counter()
    found, note = (), episode.failure
    if episode.completion is not None:
        found, note = best_grasps(episode.completion, job.method, config.grasps, config.seed)
    planned_at = time.perf_counter()
    outcome = completed = _NO_GRASP
    if found:
        best = as_step(found[0])
        outcome = task.run_trial(best, margin_trials=_MARGIN_TRIALS)
        completed = task.run_trial(best, world="completed")
    rank_held = 1 if outcome.success else _first_held(task, found)
    executed_at = time.perf_counter()
    errors = _errors(episode, job.episode_seed)
    return ScoreRow(
        object=job.object_name,
        category=episode.truth.category,
        completer=job.method,
        view=job.view,
        episode_seed=job.episode_seed,
        success=outcome.success,
        reason=outcome.reason,
        lift_m=outcome.lift_m,
        slip_m=outcome.slip_m,
        falls_free=outcome.falls_free,
        least_friction=outcome.least_friction if np.isfinite(outcome.least_friction or np.inf) else None,
        margin=octaves(outcome.least_friction),
        mass_kg=episode.randomisation.mass_kg,
        friction=episode.randomisation.friction,
        grip_n=episode.randomisation.grip_n,
        completed_success=completed.success,
        completed_reason=completed.reason,
        quality=found[0].quality if found else None,
        width_m=found[0].width_m if found else None,
        cd_m=None if errors is None else errors.cd_m,
        f_score=None if errors is None else errors.f_score,
        note=note,
        rank_held=rank_held,
        timings_s={
            "complete": completed_at - started,
            "plan": planned_at - completed_at,
            "execute": executed_at - planned_at,
        },
    )


def lost_row(job: RowJob, error: WorkerLost) -> ScoreRow:
    """A failed row: the night's work goes on without it."""
    return ScoreRow(
        object=job.object_name,
        category="",
        completer=job.method,
        view=job.view,
        episode_seed=job.episode_seed,
        success=False,
        reason="no_grasp_found",
        lift_m=0.0,
        slip_m=0.0,
        falls_free=False,
        margin=0.0,
        mass_kg=0.0,
        friction=0.0,
        grip_n=0.0,
        completed_success=False,
        completed_reason="no_grasp_found",
        quality=None,
        width_m=None,
        cd_m=None,
        f_score=None,
        note=f"WorkerLost: {error}",
        timings_s={"complete": 0.0, "plan": 0.0, "execute": 0.0},
    )


def best_grasps(completion: Completion, method: str, num: int, seed: int) -> tuple[tuple[Grasp, ...], str]:
    """The best grasps that a method's planner finds on a completion, and a note where there are none."""
    name = method_names(method)[1]
    try:
        found = tuple(islice(get_planner(name)(completion, num, seed=seed), num))
        for grasp in found:
            if not isinstance(grasp, Grasp):
                raise InvalidOption(
                    f"planner {name!r} gave a {type(grasp).__name__}; a gfp_grasp.types.Grasp is expected"
                )
            as_step(grasp)
    except GfpGraspError as error:  # e.g. the completion could not be decomposed
        return (), f"{type(error).__name__}: {error}"
    except _OF_USERS as error:
        if name in PLANNERS:
            raise
        return (), f"planner {name!r} failed with {type(error).__name__}: {error}"
    return found, "" if found else "the planner found no grasp"


def as_step(grasp: Grasp) -> Grasp:
    """The grasp as `GfpGraspEnv.step` has it, which rounds actions: a trial of the score is a step of the environment.

    Raises:
        InvalidAction: The grasp lies outside of the environment's workspace.
    """
    return _CODE.decode(_CODE.encode(grasp))


@lru_cache(maxsize=16)
def task_of(objects: str, config: ScoreConfig, completer_name: str) -> GraspTask:
    """One task a process and completer, so that scenes are compiled once; a score goes object by object."""
    env = EnvConfig(
        objects=objects,
        gps=config.gps,
        detector=config.detector,
        split=config.split,
        clutter=config.clutter,
        completer=completer_name,
    )
    return GraspTask(env, num_kept=1 + config.clutter)


def _first_held(task: GraspTask, grasps: Sequence[Grasp]) -> int | None:
    """Rank of the first grasp after the best that holds the true object."""
    ranks = range(2, len(grasps) + 1)
    return next((rank for rank in ranks if task.run_trial(as_step(grasps[rank - 1])).success), None)


def _errors(episode: Episode, seed: int) -> CompletionErrors | None:
    if episode.completion is None:
        return None
    return completion_errors(episode.completion.mesh, episode.true_mesh(), rng=np.random.default_rng(seed))
