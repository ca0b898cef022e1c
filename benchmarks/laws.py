"""A rival of `koop study laws` that is another program: a process of its own, as its rivals need.

Run as ``python benchmarks/laws.py``; talks in lines of JSON. ``{"law": NAME, "constants": {...},
"u": U, "seed": N}`` begins a run and is answered with where u, in [0, 1], is to rest first; each
following line is the cost there, answered with the next u. ``requirements/rivals.txt`` has what it
takes; nothing here is imported by koop, and nothing of these packages is in it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Generator

Asking = Generator[float, float, None]


def optuna(constants: dict[str, float], u: float, seed: int) -> Asking:
    """Points of Optuna's tree-structured Parzen estimator, then rest at the best of them."""
    import optuna as package

    package.logging.set_verbosity(package.logging.WARNING)
    study = package.create_study(sampler=package.samplers.TPESampler(seed=seed))
    for _ in range(round(constants["points"])):
        trial = study.ask({"u": package.distributions.FloatDistribution(0.0, 1.0)})
        study.tell(trial, (yield trial.params["u"]))
    while True:
        yield study.best_params["u"]


def cern(constants: dict[str, float], u: float, seed: int) -> Asking:
    """CERN's extremum-seeking package, stepped through its generator."""
    import numpy as np
    from cernml import extremum_seeking

    seeker = extremum_seeking.ExtremumSeeker(
        gain=constants["gain"],
        oscillation_size=constants["amplitude"],
        oscillation_sampling=round(constants["sampling"]),
    )
    asking = seeker.make_generator(np.array([u]), bounds=(np.zeros(1), np.ones(1)))
    asked = next(asking)
    while True:
        asked = asking.send((yield float(asked.params[0])))


LAWS = {"optuna": optuna, "cern": cern}


def main() -> None:
    """Answer lines until there are no more."""
    asking: Asking | None = None
    for line in sys.stdin:
        said = json.loads(line)
        if isinstance(said, dict):
            asking = LAWS[said["law"]](said["constants"], said["u"], said["seed"])
            answer = next(asking)
        else:
            assert asking is not None
            answer = asking.send(said)
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
