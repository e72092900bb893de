"""What is missing is named with the extra that has it, and with the command that installs it."""

import pytest

from telenano.wire import extras


@pytest.mark.parametrize(
    ("module", "extra"),
    [
        ("numba", "studies"),
        ("pandas", "export"),
        ("matplotlib.pyplot", "viz"),
        ("serial", "haptic"),
        ("pymodbus", "afm"),
        ("starlette", "view"),
        ("never_heard_of", "rig"),
    ],
)
def test_what_is_missing_is_named_with_the_extra_that_has_it(module: str, extra: str) -> None:
    assert extras.extra_of(module) == extra
    assert extras.missing(module).endswith(f"[{extra}]'")


def test_the_command_names_where_this_installation_came_from(monkeypatch: pytest.MonkeyPatch) -> None:
    origins = {
        '{"dir_info": {"editable": true}, "url": "file:///a%20b/telenano"}': "pip install -e '/a b/telenano[view]'",
        '{"archive_info": {}, "url": "file:///t-0.1-py3-none-any.whl"}': "pip install '/t-0.1-py3-none-any.whl[view]'",
        '{"url": "https://example.org/t.whl"}': "pip install 'https://example.org/t.whl[view]'",
        "": "pip install 'telenano[view]'",
    }

    class Installed:
        def __init__(self, text: str) -> None:
            self.text = text

        def read_text(self, name: str) -> str:
            assert name == "direct_url.json"
            return self.text

    for text, command in origins.items():
        monkeypatch.setattr("importlib.metadata.distribution", lambda name, text=text: Installed(text))
        assert extras.how_to_install("view") == command
