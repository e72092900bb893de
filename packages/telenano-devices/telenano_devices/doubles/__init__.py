"""Doubles of devices that take a force, for tests: libraries of vendors, services, and the servo in virtual time.

Importing `libraries` sets TELENANO_ALLOW_CODE in this process and in those that it starts, so only tests import it.
"""
