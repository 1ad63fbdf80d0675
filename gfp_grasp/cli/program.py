"""The program: its commands, and what becomes of a refusal."""

from collections.abc import Sequence

import typer

from gfp_grasp.cli.benching import bench
from gfp_grasp.cli.demonstrating import demo
from gfp_grasp.cli.meshing import complete, decompose
from gfp_grasp.cli.primitives import gps
from gfp_grasp.cli.scoring import score
from gfp_grasp.cli.terminal import say_error
from gfp_grasp.cli.training import train
from gfp_grasp.errors import GfpGraspError

app = typer.Typer(
    name="gfp-grasp",
    help="One depth view in; completed watertight mesh, convex collision parts and a grasp score out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
for command in (demo, complete, decompose, score):
    app.command()(command)
for group in (gps, train, bench):
    app.add_typer(group)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program and exit: 0 done, 1 a file could not be written, 2 refused with one line that says why.

    Args:
        arguments: After the program's name; None takes those of the process.
    """
    try:
        app(args=list(arguments) if arguments is not None else None, prog_name="gfp-grasp")
    except GfpGraspError as error:
        say_error(f"{type(error).__name__}: {error}")
        raise SystemExit(2) from None
    except OSError as error:
        say_error(f"{error.strerror or error}: {error.filename or ''}")
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        say_error("stopped")
        raise SystemExit(130) from None
