"""The model file: what goes in comes out, and what does not fit is refused."""

import io
import json
import pickle
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from koopman_lifter.config import shipped_model
from koopman_lifter.model import ModelError, load


@pytest.fixture
def model():
    return load(shipped_model())


def entries(path):
    with np.load(path) as archive:
        return dict(archive)


def rewritten(tmp_path, meta=None, **arrays):
    """Write the shipped model with some entries replaced, the hash left as it was."""
    content = entries(shipped_model()) | arrays
    if meta is not None:
        described = json.loads(content["meta"].tobytes()) | meta
        content["meta"] = np.frombuffer(json.dumps(described).encode(), dtype=np.uint8)
    path = tmp_path / "model.npz"
    np.savez(path, **content)
    return path


def test_a_saved_model_is_read_back_whole(model, tmp_path):
    path = tmp_path / "copy.npz"
    model.save(path)
    assert path.read_bytes() == shipped_model().read_bytes()
    again = load(path)
    assert again.model_id == model.model_id
    assert again.meta == model.meta
    for name in ("K", "eigenvalues", "energies", "kept", "V_dom", "projector"):
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))


def test_the_residuals_are_stored_and_part_of_the_hash(model, tmp_path):
    assert model.residuals is None
    expected = replace(model, residuals=np.linspace(0.0, 0.9, 10))
    assert expected.sha256 != model.sha256
    path = tmp_path / "model.npz"
    expected.save(path)
    again = load(path)
    assert again.sha256 == expected.sha256
    np.testing.assert_array_equal(again.residuals, expected.residuals)
    for residuals, message in (
        (np.zeros(9), r"'residuals' is float64\[9\]"),
        (np.full(10, np.inf), "'residuals' holds values that are not finite"),
        (np.zeros(10), "content and hash disagree"),
    ):
        np.savez(path, **(entries(path) | {"residuals": residuals}))
        with pytest.raises(ModelError, match=message):
            load(path)


def test_the_shipped_model_is_consistent(model):
    v_dom, eigenvalues = model.V_dom, model.eigenvalues[model.kept]
    residual = model.K @ v_dom - v_dom * eigenvalues
    assert np.abs(residual).max() < 1e-6 * np.abs(model.K @ v_dom).max()
    assert (model.observables.n, model.observables.degree, model.dt) == (2, 3, 0.005)


def test_the_file_holds_no_pickle(model):
    with zipfile.ZipFile(shipped_model()) as archive:
        for name in archive.namelist():
            header = archive.read(name)[:128]
            assert header.startswith(b"\x93NUMPY")
            assert b"'|O'" not in header


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_a_truncated_file_is_refused(tmp_path, share):
    raw = shipped_model().read_bytes()
    path = tmp_path / "cut.npz"
    path.write_bytes(raw[: int(share * len(raw))])
    with pytest.raises(ModelError, match=r"cut\.npz: .*make a new one with 'koop train'"):
        load(path)


def test_a_flipped_bit_anywhere_is_noticed(tmp_path, model):
    raw = bytearray(shipped_model().read_bytes())
    path = tmp_path / "flipped.npz"
    unchanged = 0
    for position in np.random.default_rng(0).integers(0, len(raw), 150):
        damaged = raw.copy()
        damaged[position] ^= 0x10
        path.write_bytes(damaged)
        try:
            unchanged += load(path).sha256 == model.sha256  # padding and dates carry no content
        except ModelError:
            continue
    assert unchanged < 30


def test_a_pickle_is_refused_without_being_run(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (pytest.fail, ("a pickle was run",))

    array = io.BytesIO()
    header = b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little")
    text = b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"
    array.write(header + text.ljust(117) + b"\n" + pickle.dumps([Bomb()]))
    path = tmp_path / "pickle.npz"
    with zipfile.ZipFile(shipped_model()) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            target.writestr(name, array.getvalue() if name == "K.npy" else source.read(name))
    with pytest.raises(ModelError, match="pickled objects"):
        load(path)
    bare = tmp_path / "bare.npz"
    bare.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(ModelError, match="pickle"):
        load(bare)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"meta": {"version": 2}}, "has format version 2, this program reads 1"),
        ({"meta": {"format": "something"}}, "is not a Koopman model file"),
        ({"meta": {"dt": -1.0}}, "meta entry is inconsistent"),
        ({"meta": {"state_names": ["x"]}}, "meta entry is inconsistent"),
        ({"meta": {"observables": {}}}, "meta entry is incomplete"),
        ({"K": np.zeros((3, 3))}, r"'K' is float64\[3, 3\], expected float64\[10, 10\]"),
        ({"K": np.zeros((10, 10), np.float32)}, "'K' is float32"),
        ({"projector": np.zeros((7, 10))}, "'projector' is"),
        ({"kept": np.zeros(10, bool)}, "keeps no mode"),
        ({"energies": np.full(10, np.nan)}, "'energies' holds values that are not finite"),
        ({"energies": np.ones(10)}, "content and hash disagree"),
        ({"meta": {"provenance": {"edited": True}}}, "content and hash disagree"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_reason(tmp_path, change, message):
    with pytest.raises(ModelError, match=message):
        load(rewritten(tmp_path, **change))


def test_a_missing_file_and_a_missing_entry_are_named(tmp_path):
    with pytest.raises(ModelError, match=r"nowhere\.npz: cannot be read: No such file"):
        load(tmp_path / "nowhere.npz")
    content = entries(shipped_model())
    del content["V_dom"]
    path = tmp_path / "part.npz"
    np.savez(path, **content)
    with pytest.raises(ModelError, match="has no entry 'V_dom'"):
        load(path)


def test_other_content_has_another_id(model):
    assert replace(model, energies=model.energies * 2).model_id != model.model_id
    assert replace(model, provenance={}).model_id != model.model_id


def test_an_entry_that_is_no_array_is_refused(model, tmp_path):
    """Found by fuzzing: numpy returned its bytes, and the loader failed on them."""
    import zipfile

    good, bad = tmp_path / "good.npz", tmp_path / "bad.npz"
    model.save(good)
    with zipfile.ZipFile(good) as source, zipfile.ZipFile(bad, "w") as target:
        for name in source.namelist():
            target.writestr(name, b"no array" if name == "K.npy" else source.read(name))
    with pytest.raises(ModelError, match="its entry 'K' is not an array"):
        load(bad)


@pytest.mark.parametrize(
    "version", ["\x1b[31m\n", "\ud800", "x" * 5000, ["x"] * 5000], ids=range(4)
)
def test_a_refusal_is_one_line_whatever_the_file_says_of_itself(tmp_path, version):
    """Found by fuzzing: the file's own words reached the terminal."""
    with pytest.raises(ModelError, match="has format version") as caught:
        load(rewritten(tmp_path, meta={"version": version}))
    words = str(caught.value)
    assert words.isprintable()
    assert len(words) < 500


@pytest.mark.parametrize("kind", ["V8", "U3", "f8"])
def test_marks_of_another_type_are_refused(tmp_path, kind):
    """Found by fuzzing: numpy compares no structures."""
    with pytest.raises(ModelError, match="'kept' is"):
        load(rewritten(tmp_path, kept=np.zeros(10, kind)))
