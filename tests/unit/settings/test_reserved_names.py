"""Names that a package may not take: those of the models, refused by `telenano new` and where an entry is loaded."""

from pathlib import Path

import pytest
from pydantic import BaseModel

from telenano.afm.sample_models import checked_sample
from telenano.cli.new_package import new_package
from telenano.sections import afm_section as afm
from telenano.sections import controller_section as controller
from telenano.sections import hand_section as haptic
from telenano.sections import sample_section as samples
from telenano.settings import plugins
from telenano.settings.config import keys_of
from telenano.settings.device_drivers import Drivers
from telenano.settings.plugins import Plugin
from telenano.wire.errors import ConfigError

MODELS = (
    (samples.SampleConfig, samples.TAKEN, set(samples.LAYERS.names)),
    (afm.AfmConfig, afm.TAKEN, {*afm.SAMPLES.names, *afm.DRIVERS.names}),
    (haptic.HapticConfig, haptic.TAKEN, set(haptic.DRIVERS.names)),
    (controller.ControllerConfig, controller.TAKEN, controller.PACKAGE_LAWS.found.keys()),
)


@pytest.mark.parametrize(
    ("model", "taken", "packages"), MODELS, ids=["sample", "afm_node", "haptic_node", "controller"]
)
def test_every_key_of_a_section_is_taken_and_no_method_is(
    model: type[BaseModel], taken: frozenset[str], packages: set[str]
) -> None:
    assert set(keys_of(model)) - packages <= taken
    keys = set(keys_of(model)) | set(afm.SAMPLES.all().problems)
    own = {"simulated", "serial", "modbus", "tip_sample", "spring", *controller.OWN_LAWS}
    assert taken <= keys | own
    assert not {"params", "doubts", "to_params", "model_dump", "copy", "law_config"} & taken


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("sample", "friction"),
        ("sample", "lateral"),
        ("sample", "disturbances"),
        ("device", "serial"),
        ("device", "operator"),
        ("device", "begin"),
        ("law", "clamp"),
        ("law", "wave"),
        ("operator", "impedance"),
    ],
)
def test_a_package_of_such_a_name_is_not_made(tmp_path: Path, kind: str, name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name}: is a name of telenano's own"):
        new_package(kind, name, tmp_path / "package")
    assert not (tmp_path / "package").exists()


def test_an_installed_one_is_refused_where_it_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    def installed(kind: str) -> dict[str, Plugin]:
        return {"friction": Plugin(kind, "friction", "telenano-friction", "1.0", "nowhere:FRICTION")}

    monkeypatch.setattr(plugins, "installed", installed)
    monkeypatch.setattr(plugins, "_problems", {})
    words = "friction of the package telenano-friction 1.0 cannot be used: friction is a name of telenano's own"
    for loaded in (plugins.load("samples", checked_sample, afm.TAKEN), Drivers("afm_node", (), afm.TAKEN).all()):
        assert loaded.found == {}
        assert loaded.problems == {"friction": words}
        with pytest.raises(ValueError, match="is a name of telenano's own"):
            plugins.refuse(loaded, "friction")
