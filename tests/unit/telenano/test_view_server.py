"""The page beside a rig: what keeps it away is one line, and nothing of it keeps the rig from running."""

import urllib.request
from pathlib import Path

import pytest

from presets import DEFAULT_SITE_FILE
from proto.errors import ConfigError, TelenanoError
from services.viz_node import serve
from services.viz_node.serve import Tls, bind, check_exposure
from telenano import view_server


def test_without_its_packages_or_its_page_the_rig_runs_without_a_view(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    monkeypatch.setattr(view_server, "_PACKAGES", ("no_such_package",))
    with view_server.view_beside_rig(DEFAULT_SITE_FILE, shown.append):
        pass
    monkeypatch.setattr(view_server, "_PACKAGES", ())
    monkeypatch.setattr(view_server, "page_folder", lambda: None)
    with view_server.view_beside_rig(DEFAULT_SITE_FILE, shown.append):
        pass
    assert shown == [
        "no view: no_such_package is not installed: pip install 'telenano[view]'",
        "no view: its page has not been built: `make page` in the repository builds it",
    ]


def test_the_address_is_answered_from_the_beginning_and_the_process_ends_with_the_rig(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("uvicorn")
    if view_server.page_folder() is None:
        pytest.skip("the page has not been built: make page")
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(serve, "DEFAULT_PORT", 0)
    shown: list[str] = []
    with view_server.view_beside_rig(DEFAULT_SITE_FILE, shown.append):
        address = shown[0].removeprefix("view: ").partition("#")[0]
        with urllib.request.urlopen(address, timeout=60.0) as answer:
            assert b"EMERGENCY STOP" in answer.read()
    with pytest.raises(OSError):
        urllib.request.urlopen(address, timeout=5.0)


def test_a_port_that_is_taken_is_named_and_the_usual_one_replaced() -> None:
    with bind(port=0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(TelenanoError, match=f"127.0.0.1:{port}"):
            bind(port=port)


def test_nothing_leaves_this_machine_in_the_clear(tmp_path: Path) -> None:
    check_exposure("127.0.0.1", None)
    with pytest.raises(ConfigError, match="--certificate"):
        check_exposure("0.0.0.0", None)
    with pytest.raises(ConfigError, match="is not a file"):
        check_exposure("0.0.0.0", Tls(tmp_path / "absent.pem", tmp_path / "absent.key"))


def test_the_forms_are_the_schemas_of_the_nodes() -> None:
    found = view_server.forms()
    assert "wave" in found["laws"]
    assert "lte" in found["profiles"]
    assert "force_gain" in str(found["controller"])
    assert "delay_s" in str(found["delay_node"])
    assert "setpoint_n" in str(found["afm_node"])
