"""The command line: results where they should be, a clear line for each file that fails, and its exit status."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

import neusub
import shapes
from neusub.cli import main
from neusub.cli_shared import for_each
from neusub.mesh import Material, Mesh


def neusub_command(capsys, *words: object) -> tuple[int, str, str]:
    sys.argv = ["neusub", *map(str, words)]
    with pytest.raises(SystemExit) as stop:
        main()
    out = capsys.readouterr()
    return int(stop.value.code or 0), out.out, out.err


@pytest.fixture
def ball(tmp_path):
    path = tmp_path / "ball.obj"
    neusub.save(Mesh(*shapes.icosphere(1)), path)
    return path


@pytest.mark.parametrize("scheme", ["neural", "loop", "butterfly", "midpoint"])
def test_subdivide_writes_the_last_level(ball, tmp_path, capsys, scheme):
    status, out, _ = neusub_command(capsys, "subdivide", ball, "-o", tmp_path / "fine.ply", "--scheme", scheme)
    assert status == 0
    assert "80 -> 1,280 faces" in out
    assert len(neusub.load(tmp_path / "fine.ply").faces) == 1280


def test_all_levels_are_written_on_request(ball, tmp_path, capsys):
    neusub_command(capsys, "subdivide", ball, "-o", tmp_path / "f.obj", "--all-levels", "--limit-levels", 1)
    counts = [len(neusub.load(tmp_path / f"f.level{k}.obj").faces) for k in range(4)]
    assert counts == [80, 320, 1280, 5120]


def test_many_inputs_go_to_a_folder_and_a_failed_one_does_not_stop_the_others(ball, tmp_path, capsys):
    bad = tmp_path / "bad.obj"
    bad.write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")
    status, _, err = neusub_command(capsys, "subdivide", bad, ball, "-o", tmp_path / "out")
    assert status == 1
    assert (tmp_path / "out" / "ball.obj").exists()
    assert not (tmp_path / "out" / "bad.obj").exists()
    assert "bad.obj: NonFiniteError: vertex 1" in err
    assert "1 of 2 failed" in err


def test_gltf_comes_out_as_glb_in_a_folder(tmp_path, capsys):
    sphere = trimesh.Trimesh(*shapes.icosphere(1), process=False)
    for name, content in trimesh.Scene(sphere).export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    status, _, _ = neusub_command(capsys, "subdivide", tmp_path / "model.gltf", "-o", tmp_path / "fine/")
    assert status == 0
    assert len(neusub.load(tmp_path / "fine" / "model.glb").faces) == 1280


def test_an_output_without_extension_is_a_folder_for_one_input_too(ball, tmp_path, capsys):
    assert neusub_command(capsys, "subdivide", ball, "-o", tmp_path / "fine", "--levels", 1)[0] == 0
    assert len(neusub.load(tmp_path / "fine" / "ball.obj").faces) == 320


def test_a_reader_that_has_seen_enough_is_no_failure():
    words = [sys.executable, "-u", "-c", "from neusub.cli import main; main()", "models"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        error = process.stderr.read()
    assert process.returncode == 141
    assert error == b""


def test_an_existing_file_needs_overwrite(ball, tmp_path, capsys):
    words = ("subdivide", ball, "-o", tmp_path / "fine.obj", "--levels", 1)
    assert neusub_command(capsys, *words)[0] == 0
    status, _, err = neusub_command(capsys, *words)
    assert status == 1
    assert "--overwrite" in err
    assert neusub_command(capsys, *words, "--overwrite")[0] == 0


@pytest.mark.parametrize("words, message", [
    (("subdivide", "absent.obj", "-o", "x.obj"), "absent.obj"),
    (("subdivide", ".", "-o", "x.obj"), "folder"),
    (("subdivide", "BALL", "-o", "no/such/folder/x.obj"), "folder"),
    (("subdivide", "BALL", "-o", "x.xyz"), "xyz"),
    (("subdivide", "BALL", "-o", "x.obj", "--model", "nobody"), "nobody"),
    (("subdivide", "BALL", "-o", "x.obj", "--levels", "0"), "level"),
    (("subdivide", "BALL", "-o", "x.obj", "--scheme", "loop", "--levels=-1"), "levels = -1"),
    (("subdivide", "BALL", "-o", "x.obj", "--device", "nowhere"), "nowhere"),
    (("subdivide", "BALL", "-o", "x.obj", "--scheme", "midpoint", "--crease-angle", "30"), "creases"),
    (("subdivide", "BALL", "-o", "x.obj", "--scheme", "loop", "--model", "bunny"), "--model bunny is for networks"),
    (("subdivide", "BALL", "-o", "x.obj", "--scheme", "loop", "--input", "decimated"), "the scheme is loop"),
    (("render", "BALL", "-o", "x.obj"), ".png"),
    (("train", "absent.safetensors", "-o", "run"), "neusub pairs"),
    (("train", "absent.safetensors", "-o", "run", "--batch", "0"), "batch = 0"),
    (("evaluate", "BALL", "absent.ply"), "absent.ply"),
    (("subdivide", "-o", "x.obj"), "at least one file"),
])  # fmt: skip
def test_a_wrong_call_is_one_line_and_a_status(ball, tmp_path, capsys, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    status, _, err = neusub_command(capsys, *[ball if word == "BALL" else word for word in words])
    assert status != 0
    assert message in err
    assert "Traceback" not in err
    assert sorted(path.name for path in tmp_path.iterdir() if path.name != "run") == ["ball.obj"]


def test_textures_and_materials_of_others_are_not_overwritten(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in "AB":
        material = Material("m", textures=(("map_Kd", "tex.png", name.encode()),))
        (tmp_path / name).mkdir()
        neusub.save(Mesh(**shapes.uv_box(), face_data={"material": np.zeros(12, int)}, materials=(material,)),
                    f"{name}/{name}.obj")
    for words in ((), ("--overwrite",)):
        assert neusub_command(capsys, "subdivide", "A/A.obj", "B/B.obj", "-o", "out", "--levels", 1, *words)[0] == 0
        for name in "AB":
            assert neusub.load(tmp_path / "out" / f"{name}.obj").materials[0].textures[0][2] == name.encode()
    (tmp_path / "out" / "A.obj").unlink()
    status, _, err = neusub_command(capsys, "subdivide", "B/B.obj", "-o", "out/A.obj", "--levels", 1)
    assert status == 1 and "A.mtl exists" in err
    assert not (tmp_path / "out" / "A.obj").exists()


def test_creases_stay_in_the_limit_levels_and_only_where_they_are_kept(tmp_path):
    cube = Mesh(*shapes.cube())
    fine = neusub.subdivide(cube, "butterfly", 1, limit_levels=2, crease_angle=40)[-1]
    assert np.isclose(np.abs(fine.vertices - cube.vertices.mean(axis=0)).max(axis=1), np.ptp(cube.vertices) / 2).all()
    with pytest.raises(ValueError, match="has no creases"):
        neusub.subdivide(cube, "midpoint", 1, crease_angle=40)


def bad_meshes():
    for make in (shapes.fin_on_edge, shapes.two_tetrahedra_sharing_edge, shapes.bow_tie, shapes.duplicate_face,
                 shapes.with_nan, shapes.with_inf, shapes.double_sided_square, shapes.moebius, shapes.flipped_face):
        yield pytest.param(make, False, id=make.__name__)
    for make in (shapes.tetrahedron, shapes.grid, shapes.all_flipped, shapes.coincident_vertices, shapes.collinear_face,
                 shapes.two_components, shapes.isolated_first_last):
        yield pytest.param(make, True, id=make.__name__)


@pytest.mark.parametrize("make, works", bad_meshes())
def test_a_strange_mesh_gives_a_finite_result_or_a_named_error_within_a_second(make, works, tmp_path, capsys):
    vertices, faces = make()
    path = tmp_path / "in.obj"
    path.write_text("".join(f"v {x:.17g} {y:.17g} {z:.17g}\n" for x, y, z in vertices)
                    + "".join(f"f {a} {b} {c}\n" for a, b, c in faces + 1))
    began = time.perf_counter()
    status, _, err = neusub_command(capsys, "subdivide", path, "-o", tmp_path / "out.obj")
    assert time.perf_counter() - began < 5  # a second on an idle machine; a hang is what this is about
    assert status == (0 if works else 1)
    if works:
        assert np.isfinite(neusub.load(tmp_path / "out.obj").vertices).all()
    else:
        assert "Error: " in err
        assert not (tmp_path / "out.obj").exists()


def test_info_and_repair_speak_of_a_flipped_face(tmp_path, capsys):
    vertices, faces = shapes.flipped_face()
    path = tmp_path / "in.obj"
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in vertices)
                    + "".join(f"f {a} {b} {c}\n" for a, b, c in faces + 1))
    status, out, _ = neusub_command(capsys, "info", path)
    assert status == 0
    assert "OrientationError" in out or "same way" in out
    status, out, _ = neusub_command(capsys, "repair", path, "-o", tmp_path / "fixed.obj")
    assert status == 0
    assert len(neusub.load(tmp_path / "fixed.obj").faces) == len(faces)


def test_evaluate_and_render(ball, tmp_path, capsys):
    status, out, _ = neusub_command(capsys, "evaluate", ball, ball)
    assert status == 0
    assert "Hausdorff" in out or "H " in out
    status, _, _ = neusub_command(capsys, "render", ball, ball, "-o", tmp_path / "picture.png")
    assert status == 0
    assert (tmp_path / "picture.png").read_bytes()[:4] == b"\x89PNG"


def test_pairs_are_imported_and_trained_from(elephant, tmp_path, capsys):
    assert neusub_command(capsys, "import-pairs", elephant, "-o", tmp_path / "pairs")[0] == 0
    status, out, _ = neusub_command(capsys, "train", tmp_path / "pairs" / "validation.safetensors", "-o",
                                    tmp_path / "run", "--epochs", 1)
    assert status == 0
    assert "best training loss" in out
    assert (tmp_path / "run" / "model.safetensors").exists()
    again = ("train", tmp_path / "pairs" / "validation.safetensors", "-o", tmp_path / "tuned", "--epochs", 1, "--start")
    assert neusub_command(capsys, *again, tmp_path / "run" / "model.safetensors")[0] == 0
    status, _, err = neusub_command(capsys, *again[:3], tmp_path / "other", *again[4:], "default")
    assert status == 1
    assert "another network: width 48, not 32" in err


def test_help_does_not_import_torch():
    code = "import sys; import neusub.cli; sys.exit('torch' in sys.modules or 'trimesh' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.fixture
def fine(tmp_path):
    path = tmp_path / "fine.ply"
    neusub.save(Mesh(*shapes.bumpy(shapes.icosphere(3))), path)
    return path


def test_decimate_writes_the_coarse_mesh_and_its_map(fine, tmp_path, capsys):
    status, out, _ = neusub_command(capsys, "decimate", fine, "-o", tmp_path / "c.obj", "--faces", 100,
                                    "--map-file", tmp_path / "m.safetensors", "--report")
    assert status == 0
    assert "1,280 -> 100 faces" in out and "quasi-conformal error" in out
    result = neusub.SelfParameterization.load(tmp_path / "m.safetensors")
    np.testing.assert_allclose(neusub.load(tmp_path / "c.obj").vertices, result.decimated, atol=1e-6)
    assert neusub_command(capsys, "render", tmp_path / "m.safetensors", "-o", tmp_path / "m.png", "--map")[0] == 0
    assert (tmp_path / "m.png").stat().st_size > 10_000


@pytest.mark.parametrize("on_surface", [False, True])
def test_decimate_carries_what_the_mesh_has(tmp_path, capsys, on_surface):
    vertices, faces = shapes.torus(24, 16)
    uv_faces = faces + len(vertices) * (np.arange(len(faces)) % 2)[:, None]  # a seam along each edge
    fine = Mesh(vertices, faces, uv=np.concatenate([vertices[:, :2], vertices[:, 1:]]), uv_faces=uv_faces,
                face_data={"material": np.arange(len(faces)) // 384},
                materials=tuple(Material(name, (0.5, k, 0.0, 1.0)) for k, name in enumerate("ab")))
    neusub.save(fine, tmp_path / "fine.obj")
    status, out, _ = neusub_command(capsys, "decimate", tmp_path / "fine.obj", "-o", tmp_path / "c.obj", "--faces", 200,
                                    *["--on-surface"] * on_surface)
    assert status == 0 and "lie across a seam" in out
    coarse, result = neusub.load(tmp_path / "c.obj"), neusub.decimate(fine, n_faces=200)
    wanted = result.on_surface.vertices if on_surface else result.decimated
    np.testing.assert_allclose(coarse.vertices, wanted, atol=1e-12)
    under, _ = result.to_fine(np.arange(200), np.full((200, 3), 1 / 3))
    names = [coarse.materials[k].name for k in coarse.face_data["material"]]
    assert names == ["ab"[k] for k in fine.face_data["material"][under]]
    uv, uv_faces, _ = result.transfer_corners(fine.uv, fine.uv_faces)
    np.testing.assert_allclose(coarse.uv[coarse.uv_faces], uv[uv_faces], atol=1e-12)


@pytest.mark.parametrize("command", [("subdivide",), ("subdivide", "--scheme", "midpoint"), ("remesh", "--faces", 40)])
def test_more_levels_than_memory_holds_are_refused_at_once(ball, tmp_path, capsys, command):
    status, _, err = neusub_command(capsys, command[0], ball, "-o", tmp_path / "x.obj", "--levels", 40, *command[1:])
    assert status == 1 and "TooLargeError" in err and "Take fewer levels" in err
    assert not (tmp_path / "x.obj").exists()


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory")])
def test_memory_that_runs_out_is_said_in_a_line(capsys, error):
    def work(_):
        raise error

    assert for_each((Path("a.obj"),), work) == 1
    assert capsys.readouterr().err.startswith("neusub: a.obj: not enough memory for this. Take fewer levels")


def test_other_errors_are_not_hidden():
    def work(_):
        raise RuntimeError("a bug")

    with pytest.raises(RuntimeError, match="a bug"):
        for_each((Path("a.obj"),), work)


@pytest.mark.parametrize("words, message", [
    ((), "give exactly one target"),
    (("--faces", 10, "--vertices", 10), "give exactly one target"),
    (("--faces", 5000), "the mesh has 1280"),
    (("--faces", 100, "--strategy", "best"), "strategy 'best' is not one of"),
])
def test_decimate_names_what_is_wrong(fine, tmp_path, capsys, words, message):
    status, _, err = neusub_command(capsys, "decimate", fine, "-o", tmp_path / "c.obj", *words)
    assert status == 1 and message in err
    assert not (tmp_path / "c.obj").exists()


def test_remesh_fits_unless_told_not_to(fine, tmp_path, capsys):
    for name, *words in (("fitted.obj",), ("plain.obj", "--no-fit")):
        assert neusub_command(capsys, "remesh", fine, "-o", tmp_path / name, "--faces", 80, *words)[0] == 0
    fitted, plain = (neusub.load(tmp_path / name) for name in ("fitted.obj", "plain.obj"))
    assert np.array_equal(fitted.faces, plain.faces)
    assert not np.allclose(fitted.vertices, plain.vertices)


def test_remesh_writes_all_levels(fine, tmp_path, capsys):
    status, out, _ = neusub_command(capsys, "remesh", fine, "-o", tmp_path / "r.obj", "--faces", 80, "--all-levels")
    assert status == 0 and "80 base faces -> 1,280" in out
    assert [len(neusub.load(tmp_path / f"r.level{k}.obj").faces) for k in range(3)] == [80, 320, 1280]


def test_pairs_are_made_and_trained_from_and_a_failed_source_is_told(fine, tmp_path, capsys):
    words = ("pairs", fine, "-o", tmp_path / "pairs", "--per-mesh", 2, "--validation", 1, "--vertices", "30:40")
    status, out, _ = neusub_command(capsys, *words)
    assert status == 0 and "2 pairs; " in out and "quality_median" in out
    status, out, _ = neusub_command(capsys, "train", tmp_path / "pairs", "-o", tmp_path / "run", "--epochs", 1)
    assert status == 0 and "best validation loss" in out
    words = ("pairs", fine, tmp_path / "none.obj", "-o", tmp_path / "more", "--per-mesh", 1, "--vertices", "30:40")
    status, out, err = neusub_command(capsys, *words)
    assert status == 1 and "1 of 2 sources failed" in err and "none.obj" in err
    assert (tmp_path / "more" / "fine.train.safetensors").exists()


def test_a_range_of_sizes_that_is_none_is_named(fine, tmp_path, capsys):
    status, _, err = neusub_command(capsys, "pairs", fine, "-o", tmp_path / "p", "--vertices", "many")
    assert status == 1 and "write FEWEST:MOST" in err
