"""Checks of both halves of every law at the corners of their inputs and settings, in a separate process.

    python corners.py SEED CASES

It runs the steps like the nodes, but as plain Python: there, unlike in compiled code, some overflows raise exceptions.
It prints a line for each case with NaN or infinity.
"""

import sys

from telenano.lockstep.law_corners import NotANumberError, check, failures

__all__ = ["NotANumberError", "check", "failures"]

if __name__ == "__main__":
    for line in failures(int(sys.argv[1]), int(sys.argv[2])):
        sys.stdout.write(line + "\n")
