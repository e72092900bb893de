"""The laws that tests of the core try one by one."""

from telenano.sections import OWN_LAWS

# the laws of the core, and the one of a package that a slow instrument needs
TRIED_LAWS = (*OWN_LAWS, "model_mediated")
