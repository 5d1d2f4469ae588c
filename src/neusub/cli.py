"""The command line: each command is a thin layer over a public function, imported when it runs."""

from __future__ import annotations

import os
import sys
import warnings
from io import TextIOWrapper
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from neusub import cli_learning  # noqa: F401 (its commands join the app)
from neusub.cli_shared import Output, app, check_free, check_output, for_each, level_files, loaded, progress_bar, say
from neusub.configuration import Input

QUICK = 80_000  # faces of a result that is looked through for crossings within a second or so


@app.command(name="subdivide")
def subdivide_command(
    inputs: Positional[tuple[Path, ...]],
    /,
    output: Output,
    *,
    scheme: Literal["neural", "loop", "butterfly", "midpoint"] = "neural",
    model: str | None = None,
    levels: int = 2,
    limit_levels: int = 0,
    input: Input | None = None,
    scale: Literal["edge", "box", "none"] = "edge",
    crease_angle: float | None = None,
    uncross: Literal["cages", "always", "never"] = "cages",
    all_levels: bool = False,
    device: str = "auto",
    overwrite: bool = False,
) -> int:
    """Refine meshes with a trained network or a classical scheme.

    Args:
        inputs: Mesh files: OBJ, PLY, STL, OFF, GLB (and glTF, to read).
        output: A file; with several inputs, a folder.
        scheme: The network, or a classical scheme.
        model: A model's name (see 'neusub models') or its file.
        levels: How often each triangle is split into four; by the network at least once.
        limit_levels: Levels of classic Loop after the network's.
        input: Where the coarse vertices lie, if not on the surface: 'decimated' for meshes that a decimation made.
        scale: What is brought to the training's scale: each part's mean edge, the whole box, or nothing.
        crease_angle: Edges sharper than this (degrees) stay creases; not with midpoint.
        uncross: Take displacements back where they push the surface through itself or turn it over: the network's on
            cages (up to 80,000 faces in the result: 5,000 at two levels), always, or never. On large meshes this takes
            most of the time.
        all_levels: Write each level, as NAME.level0, NAME.level1, ...
        device: auto, cpu, cuda, ...
        overwrite: Replace files that exist.
    """
    check_output(inputs, output)

    def work(path: Path) -> list[str]:
        targets = level_files(path, inputs, output, levels + limit_levels if all_levels else None)
        from neusub.io import KINDS, save

        check_free(targets, overwrite, KINDS)
        for option, value, default in (("model", model, None), ("input", input, None), ("scale", scale, "edge"),
                                       ("device", device, "auto")):
            if value != default and scheme != "neural":
                raise ValueError(f"--{option} {value} is for networks, the scheme is {scheme}. Leave one of them out.")

        mesh, notes = loaded(path)
        from neusub.subdivider import DEFAULT_MODEL, subdivide

        is_cage = scheme == "neural" and len(mesh.faces) * 4 ** (levels + limit_levels) <= QUICK
        results = subdivide(mesh, scheme, levels, model=model or DEFAULT_MODEL, limit_levels=limit_levels,
                            scale=scale, input=input, device=device, crease_angle=crease_angle,
                            uncross=is_cage if uncross == "cages" else uncross == "always")
        for level, place in zip(results[-len(targets) :], targets):
            save(level, place, overwrite=overwrite)
        return [*notes, f"{path}: {len(mesh.faces):,} -> {len(results[-1].faces):,} faces: {targets[-1]}"]

    return for_each(inputs, work)


@app.command(name="info")
def info_command(meshes: Positional[tuple[Path, ...]], /) -> int:
    """Print sizes, components, genus, boundary, quality and every problem of meshes.

    Args:
        meshes: Mesh files.
    """
    def work(path: Path) -> list[str]:
        from neusub.io import read
        from neusub.repair import info

        raw = read(path)
        return [f"{path}", *raw.report, str(info(raw))]

    return for_each(meshes, work)


@app.command(name="repair")
def repair_command(
    mesh: Positional[Path],
    /,
    output: Output,
    *,
    split_edges: bool = False,
    split_vertices: bool = False,
    weld: bool = False,
    overwrite: bool = False,
) -> int:
    """Fix what can be fixed without guessing, and say what was changed.

    Args:
        mesh: A mesh file.
        output: The repaired file.
        split_edges: Also take edges with three or more faces apart.
        split_vertices: Also give each fan of faces at a vertex its own vertex.
        weld: Also join boundary edges that lie on each other, as where each face has its own vertices.
        overwrite: Replace a file that exists.
    """
    def work(path: Path) -> list[str]:
        from neusub.io import KINDS, read, save
        from neusub.repair import repair

        check_free([output], overwrite, KINDS)
        repaired, report = repair(read(path), split_edges=split_edges, split_vertices=split_vertices, weld=weld)
        save(repaired, output, overwrite=overwrite)
        return [*(report or ["nothing to repair"]), f"{path} -> {output}"]

    return for_each((mesh,), work)


@app.command(name="evaluate")
def evaluate_command(
    result: Positional[Path], reference: Positional[Path], /, *, samples: int = 20_000, seed: int = 0
) -> int:
    """Distances between two surfaces: Hausdorff, mean, normals, flipped and degenerate triangles.

    Args:
        result: The mesh to be judged.
        reference: The mesh it should be.
        samples: Points on each surface.
        seed: Of the samples.
    """
    def work(path: Path) -> list[str]:
        from neusub.io import load
        from neusub.metrics import distance

        return [str(distance(load(path), load(reference), samples=samples, seed=seed))]

    return for_each((result,), work)


@app.command(name="render")
def render_command(
    meshes: Positional[tuple[Path, ...]],
    /,
    output: Output,
    *,
    smooth: bool = False,
    wireframe: bool = False,
    reference: Path | None = None,
    titles: tuple[str, ...] = (),
    map: bool = False,
    overwrite: bool = False,
) -> int:
    """Draw meshes side by side into a PNG, off-screen; or the map of a decimation.

    Args:
        meshes: Mesh files.
        output: The PNG.
        smooth: Smooth shading instead of flat.
        wireframe: Draw the edges.
        reference: Colour by the distance to this mesh.
        titles: One for each mesh; the file names by default.
        map: The file is a map ('neusub decimate --map-file'): draw the fine mesh coloured by coarse face, the
            checkerboard of the map, and the charts of one collapse before and after.
        overwrite: Replace a file that exists.
    """
    def work(path: Path) -> list[str]:
        check_free([output], overwrite, (".png",))
        if map:
            from neusub.map_pictures import render_map
            from neusub.selfparam import SelfParameterization

            if len(meshes) != 1:
                raise ValueError(f"{len(meshes)} files with --map: give one map.")
            return [f"{render_map(SelfParameterization.load(meshes[0]), path)}"]
        from neusub.io import load
        from neusub.pictures import render

        render([load(mesh) for mesh in meshes], output, titles=list(titles) or [mesh.stem for mesh in meshes],
               smooth=smooth, wireframe=wireframe, reference=load(reference) if reference else None)
        return [f"{path}"]

    return for_each((output,), work)


@app.command(name="decimate")
def decimate_command(
    mesh: Positional[Path],
    /,
    output: Output,
    *,
    vertices: int | None = None,
    faces: int | None = None,
    strategy: str = "quadric",
    seed: int = 0,
    on_surface: bool = False,
    sharp_boundary_angle: float | None = None,
    map_file: Path | None = None,
    report: bool = False,
    overwrite: bool = False,
) -> int:
    """Collapse edges down to a number of vertices or faces, keeping a bijective map to the original.

    UVs, colours, materials and labels come along through the map.

    Args:
        mesh: A mesh file.
        output: The coarse mesh.
        vertices: How many to keep; or
        faces: How many to keep.
        strategy: quadric, random (the cheapest of 100 random edges), edge-length, uniform, appearance (UVs, colours
            and normals count), removal (vertices stay where they are).
        seed: Of the random strategy.
        on_surface: Put the coarse vertices where the map puts them on the surface.
        sharp_boundary_angle: Boundary vertices that turn by more (degrees) never move.
        map_file: Also write the map (a safetensors file, for SelfParameterization.load).
        report: Print distortion, flips and triangle quality.
        overwrite: Replace files that exist.
    """
    def work(path: Path) -> list[str]:
        from neusub.io import KINDS, save
        from neusub.remeshing import with_signals
        from neusub.selfparam import decimate
        from neusub.selfparam.criteria import refusals

        check_free([output], overwrite, KINDS)
        check_free([map_file] if map_file else [], overwrite, (".safetensors",))
        fine, notes = loaded(path)
        with progress_bar("left") as update:
            result = decimate(fine, n_vertices=vertices, n_faces=faces, strategy=strategy, seed=seed,
                              sharp_boundary_angle=sharp_boundary_angle, on_progress=update)
        coarse = with_signals(result)
        save(coarse if on_surface else coarse.replace_vertices(result.decimated), output, overwrite=overwrite)
        if map_file:
            result.save(map_file)
        lines = [*notes, *(f"{path}: {line}" for line in coarse.load_report),
                 f"{path}: {len(fine.faces):,} -> {len(result.faces):,} faces: {output}"]
        if not result.reached:
            lines.append(f"the target was not reached; refused: {refusals(result.counts)}")
        return lines + ([str(result.report())] if report else [])

    return for_each((mesh,), work)


@app.command(name="remesh")
def remesh_command(
    inputs: Positional[tuple[Path, ...]],
    /,
    output: Output,
    *,
    vertices: int | None = None,
    faces: int | None = None,
    levels: int = 2,
    strategy: str = "uniform",
    seed: int = 0,
    fit: bool = True,
    all_levels: bool = False,
    overwrite: bool = False,
) -> int:
    """Remesh to subdivision connectivity, every vertex on the original surface.

    Args:
        inputs: Mesh files.
        output: A file; with several inputs, a folder.
        vertices: Of the base; or
        faces: Of the base (SubdivNet reads 400 to 600).
        levels: Of refinement over the base.
        strategy: How the base is decimated (see 'neusub decimate').
        seed: Of the random strategy.
        fit: Slide the base's vertices along the surface where that brings the refinement closer.
        all_levels: Write each level, as NAME.level0, NAME.level1, ...
        overwrite: Replace files that exist.
    """
    check_output(inputs, output)

    def work(path: Path) -> list[str]:
        from neusub.io import KINDS, save
        from neusub.remeshing import remesh

        targets = level_files(path, inputs, output, levels if all_levels else None)
        check_free(targets, overwrite, KINDS)
        fine, notes = loaded(path)
        results = remesh(fine, n_vertices=vertices, n_faces=faces, levels=levels, strategy=strategy, seed=seed, fit=fit)
        for mesh, place in zip(results[-len(targets) :], targets):
            save(mesh, place, overwrite=overwrite)
        base, last = results[0], results[-1]
        return [*notes, *(f"{path}: {line}" for line in last.load_report),
                f"{path}: {len(base.faces):,} base faces -> {len(last.faces):,}: {targets[-1]}"]

    return for_each(inputs, work)


def main() -> None:
    """Entry point of the command `neusub`."""
    from neusub.errors import NeusubError

    warnings.showwarning = lambda message, *_: say(f"neusub: {message}", error=True)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal's encoding may lack what a file's name has
    try:
        status = app.cli(prog="neusub", description="Data-driven subdivision of triangle meshes.")
        sys.stdout.flush()
    except NeusubError as error:
        say(f"neusub: {type(error).__name__}: {error}", error=True)
        status = 1
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left would go into the pipe at exit
        status = 141
    except KeyboardInterrupt:
        say("neusub: interrupted", error=True)
        status = 130
    sys.exit(status)
