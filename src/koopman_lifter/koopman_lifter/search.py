"""The search for a better model after a change, in a process that gives way to every other.

It would hold Python's interpreter lock for milliseconds at a time, and a real-time priority is
inherited by threads. The model is written beside the one in use, under its id, and never over it:
the operator takes it by the lifter's parameter ``model``.
"""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from koop_core.errors import InputError, KoopError
from koop_core.whole_file import write_bytes
from koopman_lifter.candidate import Samples, learn_candidate
from koopman_lifter.model import KoopmanModel, load

LOWEST = 19  # priority that a process may give itself


@dataclass(frozen=True)
class Outcome:
    """What was found, in words, and the file of a better model; empty: there is none."""

    text: str
    file: str = ""


class Search:
    """A search that is under way, for better than the model in use, of the file ``path``.

    For the other arguments see :func:`koopman_lifter.candidate.learn_candidate`.
    """

    def __init__(
        self, model: KoopmanModel, path: Path, samples: Samples, frequency: float, omega_h: float
    ) -> None:
        words = [str(path), model.model_id, repr(frequency), repr(omega_h)]
        self._lock, self._closed = threading.Lock(), False
        self._process: subprocess.Popen[bytes] | None = None
        self._outcome: Outcome | None = None
        threading.Thread(target=self._run, args=(words, samples), daemon=True).start()

    def _run(self, words: list[str], samples: Samples) -> None:
        """Copy the samples, which takes long, beside the loop, and without the interpreter lock."""
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # of this thread
        try:
            with tempfile.TemporaryFile(buffering=0) as file:
                for array in samples:
                    np.save(file, array, allow_pickle=False)
                file.seek(0)
                with self._lock:
                    if self._closed:
                        return
                    self._process = subprocess.Popen(
                        [sys.executable, "-m", __name__, *words],
                        stdin=file,
                        stdout=subprocess.PIPE,
                        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
                    )
        except OSError as error:  # as on a full disk, which ends no loop
            self._outcome = Outcome(f"it cannot be looked for: {error}")
            return
        printed, _ = self._process.communicate()
        failed = self._process.returncode
        self._outcome = (
            Outcome(f"failed with code {failed}") if failed else Outcome(**json.loads(printed))
        )

    def outcome(self) -> Outcome | None:
        """Return what was found; None while it is looked for."""
        return self._outcome

    def close(self) -> None:
        """End it."""
        with self._lock:
            self._closed = True
            if self._process is not None:
                self._process.kill()


def find_model(
    path: Path, model_id: str, samples: Samples, frequency: float, omega_h: float
) -> Outcome:
    """Learn a candidate for a model file; write it beside that if it is better.

    Raises KoopError if the samples do not suffice, the file has another model by now, or none can
    be written.
    """
    model = load(path)
    if model.model_id != model_id:
        raise InputError(f"{path} has another model by now")
    candidate, judgement = learn_candidate(model, samples, frequency, omega_h)
    if not judgement.better:
        return Outcome(str(judgement))
    stem = re.sub(r"-[0-9a-f]{12}$", "", path.stem)
    file = path.absolute().with_name(f"{stem}-{candidate.model_id}.npz")
    content = io.BytesIO()
    candidate.save(content)
    write_bytes(file, content.getvalue())
    return Outcome(str(judgement), str(file))


def main(path: str, model_id: str, frequency: str, omega_h: str) -> None:
    """Search with the samples on standard input; print the outcome as JSON."""
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    os.nice(LOWEST)
    samples = Samples(*(np.load(sys.stdin.buffer, allow_pickle=False) for _ in Samples._fields))
    try:
        outcome = find_model(Path(path), model_id, samples, float(frequency), float(omega_h))
    except KoopError as error:
        outcome = Outcome(str(error))
    print(json.dumps(vars(outcome)))


if __name__ == "__main__":
    main(*sys.argv[1:])
