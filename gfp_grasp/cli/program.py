"""The program: its commands, and what becomes of a refusal."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import typer
from threadpoolctl import threadpool_limits

from gfp_grasp.cli.bench_peers import bench  # which adds its commands to those of the others
from gfp_grasp.cli.complete import check, complete, demo, view
from gfp_grasp.cli.meshing import decompose
from gfp_grasp.cli.primitives import gps
from gfp_grasp.cli.score import score
from gfp_grasp.cli.terminal import say_error
from gfp_grasp.cli.training import train
from gfp_grasp.errors import GfpGraspError

_STOPPED = 130
# The class of the click package, or of the copy of click in newer typers: only the ancestor of this one is in both.
_MistakeInWords = cast(
    type[typer.BadParameter], next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")
)

app = typer.Typer(
    help="One depth view in; completed watertight mesh, convex collision parts and a grasp score out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
for command in (demo, complete, check, decompose, score, view):
    app.command()(command)
for group in (gps, train, bench):
    app.add_typer(group)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program and exit: 0 done, 2 refused with one line that says why, 130 stopped.

    Args:
        arguments: After the program's name; None takes those of the process.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))  # where a user's own module:function lies
    if words[:1] != ["train"]:
        _keep_to_one_thread()
    try:
        code = app(args=words, prog_name="gfp-grasp", standalone_mode=False)
    except GfpGraspError as error:
        say_error(f"{type(error).__name__}: {error}")
        raise SystemExit(2) from None
    except OSError as error:
        say_error(f"{error.strerror or error}: {error.filename or ''}")
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        code = _STOPPED
    except _MistakeInWords as error:
        if type(error).__name__ != "NoArgsIsHelpError":  # which has printed the help when it was made
            say_error(f"{error.format_message()} Try --help.")
        raise SystemExit(2) from None
    if code == _STOPPED:
        say_error("stopped")
    raise SystemExit(code or 0)


def _keep_to_one_thread() -> None:
    """Matrices and networks are small here: on two busy cores, threads that wait made a completion 8 times slower."""
    if "OMP_NUM_THREADS" not in os.environ:
        os.environ["OMP_NUM_THREADS"] = "1"  # for libraries that are loaded later, and for workers
        threadpool_limits(1)  # for numpy, which is loaded already
