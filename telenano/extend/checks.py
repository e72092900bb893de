"""A check of one's own in `telenano doctor`: a function without arguments that returns findings."""

from telenano.doctor.checks import Finding as Finding
