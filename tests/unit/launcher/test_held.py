"""What a launcher holds of a scenario, a site and keys, read by a process that is started after all of it is gone."""

import json
import random
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from telenano.launcher.files_for_nodes import HeldForNodes
from telenano.launcher.plan import UpRequest, make_plan
from telenano.runtime.security.access_control import AccessControl
from telenano.runtime.security.keyring import Keyring
from telenano.settings import network_profiles
from telenano.settings.included import NETWORK_DIRECTORY, SCENARIO_DIRECTORY, SITE_DIRECTORY
from telenano.signals import children

# Reads as a node does: site, scenario, network, keys and list.
READER = """
import json, sys
from pathlib import Path
from telenano.files.held_files import receive
from telenano.runtime.bus.address_book import AddressBook
from telenano.settings import network_profiles
from telenano.runtime.security.access_control import AccessControl
from telenano.runtime.security.keyring import Keyring
from telenano.settings.scenario import LoadedScenario
from telenano.settings.link_settings import LinkSettings
receive(int(sys.argv[1]))
book = AddressBook.load(Path(sys.argv[2]))
loaded = LoadedScenario.load(Path(sys.argv[3]))
access = AccessControl("master", Keyring(Path(sys.argv[4])), requires_keys=book.requires_keys)
print(json.dumps({
    "nodes": sorted(book.nodes), "name": loaded.scenario.name, "key": access.public_key,
    "delay_s": loaded.section("delay_node", LinkSettings).forward.delay_s,
    "slave": access.authorize(sys.argv[5]), "roles": access.roles("slave"), "names": Keyring(Path(sys.argv[4])).names(),
}))
"""


class Files:
    """The files of a rig of two sites, in folders of their own."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.site, self.scenario = folder / "site" / "site.yaml", folder / "scenario" / "ours.yaml"
        self.networks, self.keys, self.out = folder / "networks", folder / "keys", folder / "out"
        for place in (self.site.parent, self.scenario.parent, self.networks):
            place.mkdir()
        shutil.copy(SITE_DIRECTORY / "two_sites.yaml", self.site)
        network = yaml.safe_load((NETWORK_DIRECTORY / "lan.yaml").read_text())
        network["link"] = {"forward": {"delay_s": 0.0123}}
        (self.networks / "ours.yaml").write_text(yaml.safe_dump(network))
        document = yaml.safe_load((SCENARIO_DIRECTORY / "fig12.yaml").read_text())
        self.scenario.write_text(yaml.safe_dump({**document, "name": "ours", "delay_node": {"profile": "ours"}}))
        monkeypatch.setenv("TELENANO_NETWORKS", str(self.networks))
        self.keyring = Keyring(self.keys)
        self.own = self.keyring.create("master")
        self.far = Keyring(folder / "keys-slave").create("slave").public.decode()
        self.keyring.allow("slave", self.far, ["data"])
        request = UpRequest(scenario=str(self.scenario), site_file=self.site, site="master", out=self.out)
        self.plan = make_plan(request, folder)
        self.access = AccessControl("master", self.keyring)
        self.held = HeldForNodes(self.plan, self.access)

    def read(self) -> dict[str, Any]:
        """Return what a process reads that is started now."""
        self.held.refresh()
        places = (self.plan.site_file, self.plan.scenario_file, self.keys, self.far)
        command = [sys.executable, "-c", READER, str(self.held.table), *map(str, places)]
        done = children.run(
            command, stdout=subprocess.PIPE, pass_fds=self.held.descriptors, check=True, timeout=60.0, text=True
        )
        return dict(json.loads(done.stdout))


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Files]:
    # Another test of this process may have asked for the names of the networks.
    network_profiles._names.cache_clear()
    yield Files(tmp_path, monkeypatch)
    network_profiles._names.cache_clear()
    network_profiles._read.cache_clear()


@pytest.mark.check("takes 4 s")
def test_a_node_reads_the_same_whatever_has_vanished(files: Files) -> None:
    files.plan.prepare_folder()
    before = files.read()
    assert before["name"] == "ours"
    assert before["delay_s"] == 0.0123
    assert before["key"] == files.own.public.decode()
    assert before["slave"] == ["slave", ""]
    vanishing = [files.site, files.scenario, files.networks, files.keys, files.out]
    for path in random.Random(0).sample(vanishing, len(vanishing)):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        assert files.read() == before, path


@pytest.mark.check("takes 3 s")
def test_a_key_that_was_revoked_does_not_come_back_with_the_list_that_is_held(files: Files) -> None:
    assert files.read()["roles"] == ["data"]
    files.keyring.revoke("slave")
    # A list that is there is read, also by who was started before the launcher has looked at it.
    assert files.read()["slave"] == ["slave", "revoked"]
    assert files.access.reload()
    shutil.rmtree(files.keys)
    found = files.read()
    assert (found["slave"], found["roles"]) == (["slave", "revoked"], [])


def test_files_that_changed_while_the_rig_runs_change_no_node(files: Files) -> None:
    files.plan.prepare_folder()
    files.site.write_text("nodes: {}\n")
    (files.out / "scenario.yaml").write_text("name: other\n")
    found = files.read()
    assert found["name"] == "ours"
    assert "afm_node@slave" in found["nodes"]
