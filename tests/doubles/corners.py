"""Both halves of every law at the corners of their inputs and settings, in a process of its own.

    python corners.py SEED CASES

It runs the steps as the nodes do, as plain Python: there, unlike in compiled code, some of what is too large is an
exception. It prints what was no number, one line each.
"""

import sys

from telenano.lockstep.law_corners import NotANumberError, check, failures

__all__ = ["NotANumberError", "check", "failures"]

if __name__ == "__main__":
    for line in failures(int(sys.argv[1]), int(sys.argv[2])):
        sys.stdout.write(line + "\n")
