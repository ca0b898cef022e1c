#!/usr/bin/env python3
"""A stand-in for hardware: a rig on Eclipse Cyclone DDS that shares no code with the nodes.

It measures at its own pace with its own clock, and its actuator is late and slow:

    python rig.py galloping --scale 4 --duration 300

A rig is a module with the physics (such as ``absorber.py``): it names its message and what
moves theta, ``stand.py`` and ``wire.py`` do the rest. It waits for a reader of its measurements,
and prints a line when its time is over.
"""

import argparse
import sys

import absorber
import flight
import inverter
import oscillator
import stand


def main() -> int:
    """Run the rig; return the exit code."""
    parser = argparse.ArgumentParser(prog="rig.py", description=__doc__.splitlines()[0])
    rigs = parser.add_subparsers(dest="rig", required=True, metavar="RIG")
    for module in (oscillator, absorber, flight, inverter):
        module.register(rigs)
    args = parser.parse_args()
    try:
        stand.run(args.make(args), args)
    except ValueError as error:
        print(f"rig: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
