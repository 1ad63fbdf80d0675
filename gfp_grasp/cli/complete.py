"""`gfp-grasp complete`, `check`, `demo` and `view`: recordings in, files and pages out."""

import webbrowser
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from gfp_grasp.cli.terminal import (
    Files,
    Gps,
    Seed,
    check_outputs,
    direction,
    err,
    gps_option,
    out,
    table,
    vector,
    warnings_as_notes,
)
from gfp_grasp.errors import InvalidOption

if TYPE_CHECKING:
    from gfp_grasp.captures import Capture
    from gfp_grasp.complete import CompleteConfig
    from gfp_grasp.completion import Completion


def complete(
    output: Annotated[
        list[Path], typer.Option("--output", "-o", help=".obj .ply .stl .glb, .xml (MJCF) or .urdf; may be repeated.")
    ],
    cloud: Annotated[
        Path | None,
        typer.Argument(
            help="Cloud, LiDAR scan (.bin, .pcd, .npz ...) or .npz capture, metres; sample and street ship; left out "
            "with --depth."
        ),
    ] = None,
    depth: Annotated[Path | None, typer.Option(help="Instead: depth picture, 16-bit .png or .tif, or .npy.")] = None,
    intrinsics: Annotated[
        Path | None, typer.Option(help="Its camera as JSON: K, or fx, fy, cx, cy; Open3D's and RealSense's too.")
    ] = None,
    depth_scale: Annotated[
        float | None,
        typer.Option(help="Its unit in metres, or units to a metre: 0.001 or 1000; left out, millimetres."),
    ] = None,
    viewpoint: Annotated[str | None, typer.Option(help="Where the sensor stood, x,y,z in metres.")] = None,
    up: Annotated[str | None, typer.Option(help="Normal of the support, x,y,z, or auto; z if left out.")] = None,
    support_height: Annotated[float | None, typer.Option(help="Height of the support along up, metres.")] = None,
    category: Annotated[str | None, typer.Option(help="Class of the object; left out, it is found.")] = None,
    folders: Gps = None,
    detector: Annotated[
        str | None,
        typer.Option(
            help="What finds objects in a picture (votes, tabletop) or scan (pointrcnn), or your own module:function."
        ),
    ] = None,
    sensor: Annotated[
        str,
        typer.Option(
            help="What saw the cloud: tabletop (a depth camera) or lidar, whose cloud wider than 25 m is a whole scan."
        ),
    ] = "tabletop",
    each: Annotated[bool, typer.Option("--each", help="Write several objects into files of their own.")] = False,
    files: Files = False,
    bare: Annotated[bool, typer.Option("--bare", help="MJCF without contact parameters of the parts.")] = False,
    max_parts: Annotated[int, typer.Option(help="Most convex parts.")] = 80,
    max_vertices: Annotated[int | None, typer.Option(help="Most vertices of each part.")] = None,
    tolerance_mm: Annotated[
        float | None, typer.Option(help="The fewest parts of whose surface 95 % lies this near to the mesh.")
    ] = None,
    seed: Seed = 0,
) -> None:
    """Complete the object of a cloud, or every object of a depth picture or a LiDAR scan, which are one scene."""
    from gfp_grasp.captures import complete_capture
    from gfp_grasp.collision import CollisionConfig
    from gfp_grasp.complete import CompleteConfig
    from gfp_grasp.completion import CompletedScene
    from gfp_grasp.detect import upright_box
    from gfp_grasp.primitives import PrimitiveLibrary

    check_outputs(output)
    tolerance_m = None if tolerance_mm is None else tolerance_mm / 1000
    budget = CollisionConfig(max_parts, max_vertices, tolerance_m)
    config = CompleteConfig(library=PrimitiveLibrary.with_shipped(*(folders or ())), collision=budget)
    capture = _recording(cloud, depth, intrinsics, depth_scale)
    given: dict[str, object] = {}
    if viewpoint is not None:
        given["viewpoint"] = np.array(vector(viewpoint, "viewpoint"))
    if up is not None:
        given |= {"up": None if up == "auto" else np.array(vector(up, "up")), "up_is_assumed": False}
    if support_height is not None:
        given["support_height"] = support_height
    with warnings_as_notes():
        completions = complete_capture(
            replace(capture, **given), category=category, detector=detector, sensor=sensor, config=config, seed=seed
        )
        counts = [len(completion.parts) for completion in completions]
    written, how = [], {"assets": "files" if files else "embedded", "contact": not bare}
    scene = completions if isinstance(completions, CompletedScene) else None
    names = [completion.category for completion in completions] if scene is None else scene.names
    for path in output:
        if scene is not None and not each:
            written.append(scene.export(path, **how))
            continue
        for name, completion in zip(names, completions, strict=True):
            own = path if len(completions) == 1 else path.with_stem(f"{path.stem}_{name}")
            written.append(completion.export(own, **how))
    rows = []
    for name, completion, count in zip(names, completions, counts, strict=True):
        box = upright_box(np.asarray(completion.mesh.vertices), completion.detection.up)
        size_mm = " x ".join(f"{1000 * extent:.0f}" for extent in box.extents)
        score = completion.scores.get(completion.category)
        milliseconds = f"{1000 * sum(completion.timings_s.values()):.0f}"
        rows.append(
            (
                name,
                "-" if score is None else f"{score:.2f}",
                size_mm,
                f"{completion.observed.mean():.0%}",
                str(count),
                milliseconds,
            )
        )
    table(("object", "score", "size, mm", "seen", "parts", "time, ms"), rows)
    lines = [*capture.notes, *_up_note(capture, up, completions), *_notes(completions, names)]
    for line in lines:
        err.print(f"note: {line}", highlight=False, soft_wrap=True)
    out.print("wrote " + ", ".join(str(path) for path in written), highlight=False, soft_wrap=True)


def _recording(cloud: Path | None, depth: Path | None, intrinsics: Path | None, depth_scale: float | None) -> "Capture":
    """What the arguments name: a recording, or a depth picture with its camera."""
    from gfp_grasp.captures import read_capture, read_depth

    if (cloud is None) == (depth is None):
        raise InvalidOption("one recording is expected: CLOUD, or --depth PICTURE with --intrinsics JSON")
    if (depth is None) != (intrinsics is None) or (depth is None and depth_scale is not None):
        raise InvalidOption("--depth and --intrinsics go together, and --depth-scale goes with them")
    if depth is not None and intrinsics is not None:
        return read_depth(depth, intrinsics, depth_scale=depth_scale)
    assert cloud is not None
    return read_capture(cloud)


def _up_note(capture: "Capture", given: str | None, completions: Sequence["Completion"]) -> Iterator[str]:
    """Which up was taken where nobody stated one."""
    detection = completions[0].detection
    if given == "auto" or (given is None and capture.up is None):
        how = "a guess" if detection.support is None else "the normal of the plane that it stands on"
        yield f"up is estimated to be {direction(detection.up)}, {how}; --up x,y,z gives it"
    elif given is None and capture.up_is_assumed and not _is_scan(completions):
        yield "up is taken to be z, (0, 0, 1), of the recording's frame; --up auto estimates it, --up x,y,z gives it"


def _is_scan(completions: Sequence["Completion"]) -> bool:
    """Whether they are the scene of a scan, whose up is found where nobody states it."""
    from gfp_grasp.completion import CompletedScene
    from gfp_grasp.types import RangeImage

    return isinstance(completions, CompletedScene) and isinstance(completions.view, RangeImage)


def _notes(completions: Sequence["Completion"], names: Sequence[str]) -> Iterator[str]:
    """What a user may not expect: answers of no class, or against the classifier, and objects that gave way."""
    for name, completion in zip(names, completions, strict=True):
        if completion.note:
            yield f"{name}: {completion.note}"
            continue
        likeliest = max(completion.scores, key=lambda word: completion.scores[word], default=completion.category)
        if likeliest != completion.category:
            says = f"{likeliest} ({completion.scores[likeliest]:.2f})"
            yield f"{name} is named by what fits best; the classifier says {says}"
    for way in getattr(completions, "gave_way", ()):
        name, other, depth_mm = names[way.index], names[way.other], f"{1000 * way.depth_m:.0f} mm"
        if way.moved:
            yield f"{name} was cut back by {depth_mm} where it reached into {other}"
        else:
            yield f"{name} and {other} overlap by {depth_mm}"


def check(
    file: Annotated[Path, typer.Argument(help=".xml (MJCF) or .urdf, yours or anybody's.")],
    seconds: Annotated[float, typer.Option(min=0.01, help="Simulated time, in the file's own options.")] = 2.0,
) -> None:
    """Load a scene in MuJoCo as it is, and say which of its objects stand still; exit status 1 if one does not."""
    from gfp_grasp.scenes import check_file

    checks = check_file(file, seconds=seconds)
    rows = [
        (
            body.name,
            f"{body.tilt_deg:.1f}",
            f"{1000 * body.travel_m:.1f}",
            f"{1000 * body.overlap_m:.1f}",
            "yes" if body.stands else "no",
        )
        for body in checks
    ]
    table(("object", "tilt, deg", "travel, mm", "overlap, mm", "stands"), rows)
    if not all(body.stands for body in checks):
        raise typer.Exit(1)


def demo(
    folder: Annotated[Path, typer.Option("--out", help="Folder to write; open its index.html.")] = Path("out"),
    cloud: Annotated[list[Path] | None, typer.Option(help="Your own cloud of one object; may be repeated.")] = None,
    capture: Annotated[
        list[Path] | None, typer.Option(help="Your own .npz capture, or sample; may be repeated.")
    ] = None,
    street: Annotated[
        bool,
        typer.Option(
            "--street", help="Instead: the LiDAR scan of a street that ships; your recordings are such scans."
        ),
    ] = False,
    category: Annotated[str | None, typer.Option(help="Class of the object in your recordings.")] = None,
    folders: Gps = None,
    seed: Seed = 0,
) -> None:
    """Complete and grasp objects of a clutter, a single one and a room, or of your recordings, in a page."""
    from gfp_grasp.demo import run_demo  # loads simulator and networks, which --help does without

    recordings = (*(cloud or ()), *(capture or ()))
    if street and category is not None:
        raise InvalidOption(
            "--category is the class of one object, and --street completes all of a scan: give one of them"
        )
    run_demo(
        folder,
        recordings=recordings,
        street=street,
        category=category,
        config=_config(folders),
        seed=seed,
        console=out,
    )


def view(
    capture: Annotated[
        Path | None,
        typer.Argument(help="Cloud, LiDAR scan or .npz capture, metres; sample and street ship; left out: sample."),
    ] = None,
    objects: Annotated[
        str | None,
        typer.Option(
            help="Instead: episodes with procedural families (household: all of them; unknown: things of no class), "
            "a mesh file or a folder."
        ),
    ] = None,
    category: Annotated[str | None, typer.Option(help="Class of the object in the capture.")] = None,
    sensor: Annotated[
        str,
        typer.Option(
            help="What saw it: tabletop (a depth camera) or lidar, whose cloud wider than 25 m is a whole scan."
        ),
    ] = "tabletop",
    folders: Gps = None,
    host: Annotated[str, typer.Option(help="Address to listen at; 0.0.0.0 lets other machines in.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port, or the next that is free; 0 takes any.")] = 8080,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = False,
    seed: Seed = 0,
) -> None:
    """Serve a page that shows a capture, or episodes of the environment, with all that is made of them."""
    from gfp_grasp.view import view_capture, view_episodes

    if objects is not None and (capture is not None or category is not None or sensor != "tabletop"):
        raise InvalidOption(
            "--objects draws episodes of its own: give either it, or a capture (and its --category or --sensor)"
        )
    with err.status("completing and planning ..."):
        if objects is not None:
            viewer = view_episodes(objects, gps=gps_option(folders), seed=seed, host=host, port=port)
        else:
            viewer = view_capture(
                capture or "sample",
                category=category,
                sensor=sensor,
                config=_config(folders),
                seed=seed,
                host=host,
                port=port,
            )
    with viewer:
        out.print(f"{viewer.url} shows it; Ctrl-C ends", markup=False)
        if browser:
            webbrowser.open(viewer.url)
        try:
            viewer.wait()
        except KeyboardInterrupt:
            return


def _config(folders: list[Path] | None) -> "CompleteConfig":
    """The default completion, with the classes of a user's folders among those that there are."""
    from gfp_grasp.complete import CompleteConfig
    from gfp_grasp.primitives import PrimitiveLibrary

    return CompleteConfig(library=PrimitiveLibrary.with_shipped(*(folders or ())))
