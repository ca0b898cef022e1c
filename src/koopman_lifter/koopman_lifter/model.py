"""The Koopman model file: what was learned, from what, and nothing that can run code.

A model is a NumPy ``.npz`` archive (zip of ``.npy`` arrays, no pickle) plus one JSON text in the
entry ``meta``. The SHA-256 over the arrays and that text identifies the model: a damaged file is
refused, and ``model_id`` in every recorded cost names the model that made it.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koopman_lifter.config import LifterConfig, ModelConfig
from koopman_lifter.cost import Lifting
from koopman_lifter.delays import Delays
from koopman_lifter.edmd import Gram, edmd
from koopman_lifter.modes import decompose, projector, select
from koopman_lifter.observables import Monomials

FORMAT = "koopman-model"
VERSION = 1
MAX_DEPTH = 1_000_000  # samples that a delay line can hold
LONGEST = 1e6  # [s] that dt is below
MAX_BYTES = 64 * 2**20  # p = 1000 observables need 40 MB; anything larger is not a model

_ARRAYS = {  # entry: (dtype, shape in terms of p observables, N kept modes and R rows)
    "K": (np.float64, ("p", "p")),
    "eigenvalues": (np.complex128, ("p",)),
    "energies": (np.float64, ("p",)),
    "kept": (np.bool_, ("p",)),
    "V_dom": (np.complex128, ("p", "N")),
    "projector": (np.float64, ("R", "p")),
    "residuals": (np.float64, ("p",)),
}
_OPTIONAL = "residuals"


class ModelError(InputError):
    """A model file that cannot be used; the message says why and what to do."""


@dataclass(frozen=True)
class KoopmanModel:
    """A learned Koopman model with its dominant modes."""

    observables: Monomials
    """g with p observables of an n-dimensional state."""
    delays: Delays
    """Which samples of the measured channels are that state."""
    dt: float
    """Time between consecutive samples [s]."""
    state_names: tuple[str, ...]
    """Length delays.channels: names of the measured channels, in order."""
    K: NDArray[np.float64]
    """Shape (p, p): z_{k+1} = K z_k."""
    eigenvalues: NDArray[np.complex128]
    """Shape (p,): of K, largest modulus first."""
    energies: NDArray[np.float64]
    """Shape (p,): E_j, mean |c_j|^2 on the training data."""
    kept: NDArray[np.bool_]
    """Shape (p,): the dominant modes."""
    V_dom: NDArray[np.complex128]
    """Shape (p, N): right eigenvectors of the kept modes, unit 2-norm."""
    projector: NDArray[np.float64]
    """Shape (N, p), or (1, p) for a single direction: real W with ||W z|| = ||V_dom^+ z||. Stored,
    not recomputed on loading, so that the cost is the same to the last bit on machines whose linear
    algebra rounds differently."""
    provenance: dict[str, Any]
    """Where the training data came from, in JSON terms."""
    residuals: NDArray[np.float64] | None = None
    """Shape (p,): residual of every mode on the training data; None where it is not known."""

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """The part of the model that is arrays."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        return {name: array for name, array in arrays.items() if array is not None}

    @property
    def meta(self) -> dict[str, Any]:
        """The part of the model that is not arrays."""
        delays = {"count": self.delays.count, "every": self.delays.every}
        return {
            "format": FORMAT,
            "version": VERSION,
            **({"delays": delays} if self.delays.count > 1 else {}),
            "observables": {
                "kind": "monomials",
                "n": self.observables.n,
                "degree": self.observables.degree,
                "names": self.observables.names(self.delays.names(self.state_names, self.dt)),
            },
            "dt": self.dt,
            "state_names": list(self.state_names),
            "provenance": self.provenance,
        }

    @property
    def sha256(self) -> str:
        """Hash of the whole content, hexadecimal."""
        return _digest(self.arrays, _json(self.meta))

    @property
    def model_id(self) -> str:
        """First 12 digits of the hash: the name under which recordings refer to the model."""
        return self.sha256[:12]

    def lifting(self) -> Lifting:
        """Return the arrays that ``koopman_lifter.cost`` takes."""
        delays = self.delays
        return Lifting(
            self.observables.parent,
            self.observables.factor,
            self.projector,
            delays.channels,
            delays.n,
            delays.every,
        )

    def save(self, path: str | Path | IO[bytes]) -> None:
        """Write the model file; the same model gives the same bytes."""
        text, arrays = _json(self.meta), self.arrays
        texts = {"meta": text, "sha256": _digest(arrays, text)}
        entries = {k: np.frombuffer(v.encode(), dtype=np.uint8) for k, v in texts.items()} | arrays
        with zipfile.ZipFile(path, "w") as archive:
            for name, array in entries.items():
                # np.savez would write the time of day into the archive
                info = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
                with archive.open(info, "w") as file:
                    np.save(file, np.ascontiguousarray(array), allow_pickle=False)


def build(
    gram: Gram,
    dt: float,
    state_names: tuple[str, ...],
    count: int,
    provenance: dict[str, Any],
    delays: Delays | None = None,
) -> KoopmanModel:
    """Learn a model from summed training data.

    Parameters
    ----------
    gram : Gram
        Sums over all snapshot pairs.
    dt : float
        Time between consecutive states [s].
    state_names : tuple of str
        Names of the measured channels.
    count : int
        N, modes to keep; one more is kept where N would split a complex pair, and as many as there
        are where N is more.
    provenance : dict
        Source of the data; the numbers of pairs and modes are added here.
    delays : Delays, optional
        What the states in ``gram`` are; None: the channels as they are.

    Raises
    ------
    koop_core.errors.InputError
        If the data cannot determine K, or ``count`` is less than 1.
    """
    koopman = edmd(gram)
    modes = decompose(koopman, gram)
    kept = select(modes, min(count, modes.energies.size))
    v_dom = modes.vectors[:, kept]
    return KoopmanModel(
        gram.observables,
        delays or Delays(gram.observables.n),
        float(dt),
        tuple(state_names),
        koopman.matrix,
        modes.eigenvalues,
        modes.energies,
        kept,
        v_dom,
        projector(v_dom, modes.eigenvalues[kept]),
        {
            **provenance,
            "pairs": gram.pairs,
            "condition": round(koopman.condition, 3),
            "modes_asked": count,
            "modes_kept": int(kept.sum()),
        },
        modes.residuals,
    )


def load(path: str | Path) -> KoopmanModel:
    """Read and check a model file.

    Raises
    ------
    ModelError
        If the file is missing, damaged, not a model, of another version, inconsistent in shape, or
        holds values that are not finite.
    """
    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise ModelError(f"{path}: larger than {MAX_BYTES >> 20} MiB, this is not a model file")
        raw = Path(path).read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        return _parse(_entries(raw))
    except ModelError as error:
        raise ModelError(f"{path}: {error}; make a new one with 'koop train'") from None


def load_for(config: LifterConfig, chosen: ModelConfig, n: int = 0) -> KoopmanModel | None:
    """Return the model that a lifter uses; None if the raw cost does without.

    A model that fits is used for the raw cost, too: its id is recorded.

    Parameters
    ----------
    config, chosen
        Settings and model parameters of the lifter.
    n : int
        Number of measured values; 0: not known.

    Raises
    ------
    ModelError
        If the lifted cost cannot have the model.
    """
    try:
        return load_fitting(chosen.path, config.dt, n)
    except ModelError:
        if config.cost == "raw":
            return None
        raise


def load_fitting(path: Path, dt: float, n: int = 0) -> KoopmanModel:
    """Read a model file for a sampling time [s] and a number of measured values, 0: any.

    Raises
    ------
    ModelError
        As :func:`load`, or if the model is for others.
    """
    model = load(path)
    if model.dt != dt:
        raise ModelError(
            f"{path}: trained at dt = {model.dt} s, this node runs at dt = {dt} s; "
            "train a model at that step or set the parameter dt"
        )
    if n not in (0, model.delays.channels):
        raise ModelError(
            f"{path}: trained on {model.delays.channels} channels, the state has {n}; "
            "train a model on these"
        )
    return model


def _entries(raw: bytes) -> dict[str, NDArray[Any]]:
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            if sum(info.file_size for info in archive.infolist()) > MAX_BYTES:
                raise ModelError("unpacks to more than a model can hold")
        with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
            entries = {name: archive[name] for name in archive.files}
    except ModelError:
        raise
    except Exception as error:  # zipfile and npy headers fail in many ways on arbitrary bytes
        words = _short(str(error))
        if "allow_pickle" in words:
            raise ModelError("holds pickled objects, which could run code") from None
        raise ModelError(f"truncated, damaged or not a model file ({words})") from None
    for name, entry in entries.items():
        if not isinstance(entry, np.ndarray):  # numpy hands out an entry without its mark as bytes
            raise ModelError(f"damaged: its entry {name[:60]!a} is not an array")
    return entries


def _parse(entries: dict[str, NDArray[Any]]) -> KoopmanModel:
    text = _text(entries, "meta")
    try:
        meta = json.loads(text)
    except (ValueError, RecursionError):
        raise ModelError("its meta entry is not JSON text") from None
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise ModelError("is not a Koopman model file")
    if meta.get("version") != VERSION:
        version = _short(meta.get("version"))
        raise ModelError(f"has format version {version}, this program reads {VERSION}")
    stored = {name for name in _ARRAYS if name != _OPTIONAL or name in entries}
    if missing := stored - entries.keys():
        raise ModelError(f"has no entry '{min(missing)}'")
    observables, delays, dt, state_names, provenance = _described(meta)
    modes = int(entries["kept"].sum()) if entries["kept"].dtype == np.bool_ else observables.p
    sizes = {"p": observables.p, "N": modes, "R": modes}
    if entries["projector"].shape[:1] == (1,):
        sizes["R"] = 1
    if sizes["N"] == 0:
        raise ModelError("keeps no mode")
    arrays = {name: entries[name] for name in _ARRAYS if name in stored}
    for name, array in arrays.items():
        dtype, axes = _ARRAYS[name]
        shape = tuple(sizes[axis] for axis in axes)
        if array.dtype != dtype or array.shape != shape:
            raise ModelError(
                f"'{name}' is {array.dtype}{list(array.shape)}, "
                f"expected {np.dtype(dtype)}{list(shape)}"
            )
        if not np.isfinite(array).all():
            raise ModelError(f"'{name}' holds values that are not finite")
    if _digest(arrays, text) != _text(entries, "sha256"):
        raise ModelError("content and hash disagree: the file was damaged or edited")
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    return KoopmanModel(observables, delays, dt, state_names, provenance=provenance, **contiguous)


def _described(
    meta: dict[str, Any],
) -> tuple[Monomials, Delays, float, tuple[str, ...], dict[str, Any]]:
    try:
        described = meta["observables"]
        if described["kind"] != "monomials":
            raise ModelError(f"has unknown observables {_short(described['kind'])}")
        n, degree, dt = int(described["n"]), int(described["degree"]), float(meta["dt"])
        state_names = tuple(str(name) for name in meta["state_names"])
        provenance = dict(meta["provenance"])
        past = meta.get("delays", {"count": 1, "every": 1})
        count, every = int(past["count"]), int(past["every"])
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ModelError("its meta entry is incomplete") from None
    fits = 1 <= n <= 4096 and 1 <= degree <= 16 and len(state_names) * count == n
    if not (fits and 0.0 < dt < LONGEST and 1 <= every * count <= MAX_DEPTH):
        raise ModelError("its meta entry is inconsistent")
    if math.comb(n + degree, n) > 4096:
        raise ModelError("has too many observables")
    try:
        delays = Delays(len(state_names), count, every)
    except ValueError:
        raise ModelError("its meta entry is inconsistent") from None
    return Monomials(n, degree), delays, dt, state_names, provenance


def _text(entries: dict[str, NDArray[Any]], name: str) -> str:
    if name not in entries or entries[name].dtype != np.uint8:
        raise ModelError(f"has no entry '{name}', it is not a Koopman model file")
    try:
        return entries[name].tobytes().decode()
    except UnicodeDecodeError:
        raise ModelError(f"its entry '{name}' is not text") from None


def _short(value: object) -> str:
    """Return a value out of a file as a few characters of one line."""
    words = ascii(value)
    return words if len(words) <= 80 else f"{words[:77]}..."


def _json(meta: dict[str, Any]) -> str:
    return json.dumps(meta, sort_keys=True, indent=1)


def _digest(arrays: dict[str, NDArray[Any]], text: str) -> str:
    digest = hashlib.sha256(text.encode())
    for name, array in arrays.items():
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
