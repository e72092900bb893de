"""Doubles of devices that take a force, for tests: libraries of vendors, services, and the servo in virtual time.

What compiles a library sets TELENANO_ALLOW_CODE in this process and those that it starts: only tests import this.
"""
