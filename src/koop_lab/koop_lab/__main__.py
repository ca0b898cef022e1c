"""``python -m koop_lab`` is ``koop``."""

import gc
import signal

if __name__ == "__main__":
    # The imports take a second. Until main() takes it over, Ctrl-C ends the process without a
    # traceback, unless it was started with Ctrl-C ignored.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()  # while the command is imported, of which next to nothing is garbage
    from koop_lab.cli.main import main
    from koop_node.process.ending import end_process

    end_process(main())
