"""`gfp-grasp train peer`: the networks that GFPNet is compared with."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli import training
from gfp_grasp.cli.terminal import Seed, Workers, out
from gfp_grasp.cli.training import Device, Out, Runs, Steps, train


@train.command()
def peer(
    name: Annotated[str, typer.Argument(help="pcn, foldingnet, topnet, 3d-epn, 3d-sc or scrg.")],
    true_box: Annotated[
        bool,
        typer.Option("--true-box", help="Learn in the true box, as the papers do; left out, around what was seen."),
    ] = False,
    classes: Annotated[
        str | None,
        typer.Option(help="Classes to learn from, with commas between; left out, households and those of the paper."),
    ] = None,
    file: Out = None,
    steps: Steps = None,
    members: Annotated[
        int | None, typer.Option(min=1, help="Objects of each class; left out, those of the shipped weights.")
    ] = None,
    runs: Runs = Path("runs"),
    device: Device = "cpu",
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """One of the networks that GFPNet is compared with: two hours of one core, whichever it is."""
    from gfp_grasp.peers import get_peer
    from gfp_grasp.train import PEER_CONFIGS, train_peer

    get_peer(name)
    config = replace(PEER_CONFIGS[name], seed=seed, device=device)
    config = replace(config, steps=steps or config.steps, members=members or config.members)
    with training._bar(name, config.steps) as report:
        card = train_peer(
            name,
            true_box=true_box,
            config=config,
            classes=training._listed(classes),
            out=file,
            runs=runs,
            workers=workers,
            report=report,
        )
    out.print(str(card), markup=False)


__all__ = ["peer", "train"]
