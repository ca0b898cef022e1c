"""The rig as a program: ``rig_program.py HEARD END``.

Writes theta into HEARD whenever it hears another one; ends when told to by a signal, or with the
exit code in END once that file is there.
"""

import signal
import sys
import time
from pathlib import Path

from commission_rig import FastRig

asked = []
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda *_: asked.append(True))
heard, end = map(Path, sys.argv[1:])
rig, known = FastRig(), None
while not asked and not end.exists():
    if rig.theta != known:
        known = rig.theta
        heard.write_text(f"{known}\n")
    time.sleep(0.005)
heard.write_text(f"{rig.theta}\n")
rig.close()
sys.exit(0 if asked else int(end.read_text()))
