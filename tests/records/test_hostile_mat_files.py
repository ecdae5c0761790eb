"""MAT files that are damaged, or made to do harm: refused, or read without what they point at."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records.mat_file import read_mat
from tests.records.matlab_files import write_v5, write_v73

T = np.arange(500) * 0.01
RUN = {"run": {"time": T, "signals": [{"values": T[:, None], "label": "p"}, {"values": T[:, None], "label": "q"}]}}


@pytest.mark.parametrize("write", [write_v5, write_v73])
@pytest.mark.parametrize("part", [0.0, 0.02, 0.3, 0.7, 0.97])
def test_a_truncated_file_is_refused(write, part, tmp_path):
    path = tmp_path / "a.mat"
    write(path, RUN)
    path.write_bytes(path.read_bytes()[: int(part * path.stat().st_size)])
    with pytest.raises(DataError, match=r"a.mat: .*[Cc]opy") as error:
        read_mat(path)
    assert len(str(error.value)) < 500


def test_other_bytes_are_refused(tmp_path):
    for content in (b"junk" * 100, b"MATLAB 7.3 MAT-file" + bytes(600), b"\x89HDF\r\n\x1a\n" + bytes(100)):
        (tmp_path / "a.mat").write_bytes(content)
        with pytest.raises(DataError, match="not a whole MAT file"):
            read_mat(tmp_path / "a.mat")


def columns(path):
    return {c.name: c for c in read_mat(path).columns}


def test_links_into_other_files_are_not_followed(tmp_path):
    secret, path = tmp_path / "secret.mat", tmp_path / "a.mat"
    write_v73(secret, {"x": T})
    secret.with_suffix(".bin").write_bytes(T.tobytes())
    write_v73(path, {"time": T, "p": T})
    with h5py.File(path, "r+") as file:
        file["link"] = h5py.ExternalLink(str(secret), "x")
        file["soft"] = h5py.SoftLink("/p")
        file.create_dataset("raw", (500,), "f8", external=[(str(secret.with_suffix(".bin")), 0, 4000)])
        layout = h5py.VirtualLayout((500,), "f8")
        layout[:] = h5py.VirtualSource(str(secret), "x", (500,))
        file.create_virtual_dataset("virtual", layout)
    found = columns(path)
    assert found["p"].values.tolist() == T.tolist()
    for name in ("link", "soft", "raw", "virtual"):
        assert "stored in another" in found[name].unusable and np.isnan(found[name].values).all()


def test_a_claim_of_more_data_than_a_file_can_hold_is_refused(tmp_path):
    path = tmp_path / "a.mat"
    write_v73(path, {"time": T})
    with h5py.File(path, "r+") as file:
        file.create_dataset("p", (10**12,), "f8", chunks=(10**6,))
    with pytest.raises(DataError, match="claims 8e"):
        read_mat(path)


def test_references_in_a_circle_or_without_end_are_refused(tmp_path):
    path = tmp_path / "a.mat"
    write_v73(path, {"time": T, "c": (T,)})
    with h5py.File(path, "r+") as file:
        file["c"][0, 0] = file["c"].ref
    with pytest.raises(DataError, match="nested more deeply"):
        read_mat(path)


def test_a_sparse_matrix_says_how_to_save_it(tmp_path):
    path = tmp_path / "a.mat"
    write_v73(path, {"time": T, "p": T, "s": {"data": T, "ir": T, "jc": T}})
    with h5py.File(path, "r+") as file:
        file["s"].attrs["MATLAB_sparse"] = np.uint64(500)
    assert "full(x)" in columns(path)["s"].unusable


def test_a_large_file_reads_in_seconds(tmp_path):
    import time

    count = 200_000
    path = tmp_path / "a.mat"
    many = {f"x{k}": np.random.default_rng(k).normal(size=count) for k in range(10)}
    write_v73(path, {"time": np.arange(count) * 1e-3, **many})
    start = time.process_time()
    assert len(read_mat(path).columns) == 11
    assert time.process_time() - start < 1.0


def test_a_flaw_in_the_tag_of_an_element_is_refused_and_ends_no_process(tmp_path):
    path = tmp_path / "a.mat"
    write_v5(path, RUN)
    whole = path.read_bytes()
    numbers = whole.index((9).to_bytes(4, "little") + T.nbytes.to_bytes(4, "little"))
    for at, value in ((numbers, 208), (numbers + 1, 127), (numbers + 6, 255)):
        path.write_bytes(whole[:at] + bytes([value]) + whole[at + 1 :])
        with pytest.raises(DataError, match="not a whole MAT file"):
            read_mat(path)


@pytest.mark.parametrize("write", [write_v5, write_v73])
def test_no_flaw_of_a_byte_raises_anything_but_a_refusal(write, tmp_path):
    rng = np.random.default_rng(0)
    path = tmp_path / "a.mat"
    write(path, {"run": {"time": T[:9], "p": T[:9], "note": "rig 3"}, "c": (T[:9], "a")})
    whole = np.frombuffer(path.read_bytes(), "u1")
    refused = 0
    for _ in range(150):
        flawed = whole.copy()
        flawed[rng.integers(len(whole), size=5)] = rng.integers(256, size=5)
        path.write_bytes(flawed.tobytes())
        try:
            read_mat(path)
        except DataError:
            refused += 1
    assert refused > 20
