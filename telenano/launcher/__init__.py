"""Planning and supervision of a rig, or of one site of it, for `telenano up` and the commands that inspect rigs."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.launcher.plan import check_files as check_files
    from telenano.launcher.plan import check_sections as check_sections
    from telenano.launcher.rigs import running_rigs as running_rigs
    from telenano.launcher.scenario_keys import all_keys as all_keys
else:
    __getattr__, __dir__ = face(__name__)
