"""`gfp-grasp bench` of the paper's network: what its parts are worth, and which others are quicker or nearer."""

from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.bench import bench
from gfp_grasp.cli.terminal import JsonFile, Seed, Workers, err, save_json, table

_LimitOfClass = Annotated[int, typer.Option("--limit", min=1, help="Shapes of each class.")]
_Steps = Annotated[int, typer.Option(min=1, help="Steps of each network.")]
_Runs = Annotated[Path, typer.Option(help="Folder of caches and of finished networks.")]


@bench.command()
def ablation(
    steps: _Steps = 2400,
    limit: _LimitOfClass = 80,
    runs: _Runs = Path("runs"),
    workers: Workers = 1,
    json_file: JsonFile = None,
    picture: Annotated[Path | None, typer.Option(dir_okay=False, help="Draw the rows to this .svg file.")] = None,
    seed: Seed = 0,
) -> None:
    """The paper's networks by layers, widths and iterations, trained alike; a run that was stopped goes on."""
    from gfp_grasp.bench import AblationConfig, bench_ablation
    from gfp_grasp.drawing import write_curves

    config = AblationConfig(steps=steps, limit=limit, seed=seed)
    report = bench_ablation(config=config, runs=runs, workers=workers, report=err.print)
    rows = report["rows"]
    headings = ("encoder", *(f"m = {m}" for m in report["settings"]["iterations"]), "1/3", "2/3")
    cells = [(name, *(f"{v:.4f}" for v in (*row["cd_units"], *row["thirds"][:2]))) for name, row in rows.items()]
    title = "Chamfer distance in units of the patch; at last, of m = 5 after a third and two thirds of the steps"
    table(headings, cells, title=title)
    if picture is not None:
        panels: dict[str, dict[str, list[float]]] = {}
        for name, row in rows.items():
            plain = row["reading"] == "as taken" and not row["noise_m"]
            panel = f"codes of {row['widths'][-1]}" if plain else "learnt otherwise"
            panels.setdefault(panel, {})[name] = row["cd_units"]
        title = f"Layers and widths by iterations after {steps} steps of {config.batch} patches"
        write_curves(panels, picture, title=title, axis="iterations m")
    save_json(json_file, report)


@bench.command()
def search(
    trials: Annotated[int, typer.Option(min=1, help="Networks to measure.")] = 40,
    steps: _Steps = 400,
    limit: _LimitOfClass = 80,
    runs: _Runs = Path("runs"),
    workers: Workers = 1,
    json_file: JsonFile = None,
    picture: Annotated[Path | None, typer.Option(dir_okay=False, help="Draw all networks to this .svg file.")] = None,
    seed: Seed = 0,
) -> None:
    """Networks of the paper's kind that are quicker or nearer, by evolution; a run that was stopped goes on."""
    from gfp_grasp.bench import SearchConfig, bench_search
    from gfp_grasp.drawing import write_front

    config = SearchConfig(steps=steps, limit=limit, seed=seed, trials=trials)
    report = bench_search(config=config, runs=runs, workers=workers, report=err.print)
    found, paper = report["trials"], report["paper"]
    rows = [*report["front"], {**paper, "name": f"the paper's: {paper['name']}"}]
    cells = [(row["name"], f"{row['ms']:.2f}", f"{row['cd_units']:.4f}", str(row["parameters"])) for row in rows]
    headings = ("encoder, decoder, iterations m", "ms", "CD, patch units", "parameters")
    table(headings, cells, title=f"front of {len(found)} networks")
    if picture is not None:
        title = f"Networks of the paper's kind after {steps} steps of {config.batch} patches"
        write_front(found, report["front"], paper, picture, title=title)
    save_json(json_file, report)
