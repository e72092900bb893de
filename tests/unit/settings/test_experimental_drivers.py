"""A driver that never drove a real device reports so: where its node starts, before a session, and in the list."""

from pathlib import Path

import pytest

from telenano.cli.commands.device import package_rows
from telenano.launcher.plan import UpRequest, make_plan
from telenano.sections.afm_section import DRIVERS as INSTRUMENTS
from telenano.sections.hand_section import DRIVERS as HANDLES
from telenano.settings import TWO_SITES_FILE
from telenano.settings.device_drivers import Drivers

# No real device has been on the rig yet (trial.md): a driver leaves this table with the recording that shows one.
EXPERIMENTAL = {
    "haptic_node": {"serial", "haply", "dhd", "hd"},
    "afm_node": {"modbus", "gwyscope", "nanonis"},
}
SIMULATED = {
    "haptic_node": {"simulated", "simulated_impedance"},
    "afm_node": {"simulated"},
}


@pytest.mark.parametrize(("node", "drivers"), [("haptic_node", HANDLES), ("afm_node", INSTRUMENTS)])
def test_every_driver_of_a_real_device_is_experimental_and_no_other(node: str, drivers: Drivers) -> None:
    known = {*drivers._own, *drivers.all().found}
    assert known == EXPERIMENTAL[node] | SIMULATED[node]
    for name in known:
        text = drivers.caution(name)
        assert bool(text) == (name in EXPERIMENTAL[node])
        if text:
            assert text.startswith(f"{node}.driver: {name} is experimental")
    assert drivers.caution(None) == ""


def test_a_session_warns_of_the_drivers_that_it_starts_and_of_no_other(tmp_path: Path) -> None:
    settings = ("haptic_node.driver=haply", "afm_node.environment=spring")
    request = UpRequest(scenario="fig12", out=tmp_path, settings=settings)
    (text,) = make_plan(request, tmp_path).cautions
    assert text.startswith("haptic_node.driver: haply is experimental")
    far = UpRequest(scenario="fig12", out=tmp_path, settings=settings, site="slave", site_file=TWO_SITES_FILE)
    assert make_plan(far, tmp_path).cautions == ()
    assert make_plan(UpRequest(scenario="fig12", out=tmp_path), tmp_path).cautions == ()


def test_the_list_of_devices_says_so() -> None:
    found = {row["driver"]: row["found"] for row in package_rows()}
    assert found["gwyscope"] == "can be used, experimental: it has driven an emulator only"
