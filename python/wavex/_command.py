"""The command ``wavex``: the same program as the Rust binary."""

import signal
import sys

from ._wavex import main as _main


def main() -> int:
    """Run the command line; returns the exit status."""
    # The program handles signals itself, or ends by them.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _main(["wavex", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
