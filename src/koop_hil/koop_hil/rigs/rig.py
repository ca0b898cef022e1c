#!/usr/bin/env python3
"""A stand-in for hardware: a rig on Eclipse Cyclone DDS that shares no code with the nodes.

It measures at its own pace with its own clock, and its actuator is late and slow:

    python rig.py galloping --scale 4 --duration 300
    python rig.py jsbsim --scale 4
    python rig.py fmu MODEL.fmu --input stiffness --outputs x,v --dt 0.01

The first three are oscillators of our own; jsbsim is an aircraft in turbulence, fmu any Functional
Mock-up Unit. It waits for a reader of its measurements, and prints a line when its time is over.
"""

import argparse
import os
import sys
import threading

import flight
import fmu
import oscillator
from stand import Stand, options


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    made = argparse.ArgumentParser(prog="rig.py", description=__doc__.splitlines()[0])
    rigs = made.add_subparsers(dest="rig", required=True, metavar="RIG")
    for module in (oscillator, flight, fmu):
        module.register(rigs, options())
    return made


def main() -> int:
    """Run the rig; return the exit code."""
    args = parser().parse_args()

    def begin(stand: Stand) -> Stand:
        if args.until_eof:  # a read returns when the parent has ended: nothing is ever written
            threading.Thread(target=lambda: (os.read(0, 1), stand.stop()), daemon=True).start()
        stand.wait()
        return stand

    try:
        args.run(args, begin)
    except ValueError as error:
        print(f"rig: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
