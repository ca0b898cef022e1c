"""The baseline of ``koop bench realtime``: a program that does nothing but wake at every tick.

Run as ``python -m koop_bench.bare_timer RATE SECONDS PRIORITY``; prints a line of JSON. The
ticks that it misses are the machine's, not the nodes'.
"""

from __future__ import annotations

import gc
import json
import sys
import time

from koop_core.stream.durations import Durations
from koop_node.process.realtime import apply_priority
from vdp_plant.pacing import Ticks


def main(rate: float, seconds: float, priority: int) -> None:
    """Wake at a rate [1/s] for a time [s], with real-time priority and locked memory."""
    problems = apply_priority(priority)
    gc.disable()
    period = 1.0 / rate
    ticks, behind, late, done = Ticks(period), Durations(), 0, 0
    begin = due = time.monotonic()
    ticks.start(begin)
    while done + late < round(rate * seconds):
        due = begin + (done + late + 1) * period
        while (now := time.monotonic()) < due:
            time.sleep(due - now)
        late += ticks.tick(now)
        behind.add(ticks.behind)
        done += 1
    quantiles = [behind.quantile(share) for share in (0.99, 0.999, 1.0)]
    print(json.dumps({"done": done, "late": late, "behind": quantiles, "problems": problems}))


if __name__ == "__main__":
    main(float(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
