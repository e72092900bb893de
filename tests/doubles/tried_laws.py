"""The laws that tests of the core run one by one."""

from telenano.sections import OWN_LAWS

# The laws of the core, and the one of a package that a slow instrument needs.
TRIED_LAWS = (*OWN_LAWS, "model_mediated")
