"""The public face of each room: every name that it lists is there, and nothing is imported before it is used."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import telenano
from telenano.lazy_exports import names_of

LIBRARY = Path(telenano.__path__[0])
FACES = sorted(path.parent.name for path in LIBRARY.glob("*/__init__.py") if "import face" in path.read_text("utf-8"))


def text_of(room: str) -> str:
    return (LIBRARY / room / "__init__.py").read_text(encoding="utf-8")


@pytest.mark.parametrize("room", FACES)
def test_every_name_of_a_face_is_there_and_is_listed_once(room: str) -> None:
    names = names_of(text_of(room))
    package = importlib.import_module(f"telenano.{room}")
    listed = [
        each.asname
        for part in ast.walk(ast.parse(text_of(room)))
        if isinstance(part, ast.ImportFrom)
        for each in part.names
    ]
    assert sorted(name for name in listed if name) == sorted(names)
    for name, module in names.items():
        assert module.startswith(f"telenano.{room}."), f"{name} belongs to another room"
        assert getattr(package, name) is getattr(importlib.import_module(module), name)
    assert set(names) <= set(dir(package))


@pytest.mark.parametrize(
    ("before", "now", "names"),
    [
        ("afm", "sections", "AfmConfig AfmControllerConfig SAMPLES SampleConfig read_surface"),
        ("afm", "settings", "CurveSettings DisturbanceConfig ScanSettings"),
        ("hand", "sections", "ARMS HapticConfig LateralPath LimitsConfig"),
        ("laws", "sections", "ControllerConfig LAWS OWN_LAWS changed_config late_periods"),
    ],
)
def test_a_package_of_before_finds_a_name_where_it_was(before: str, now: str, names: str) -> None:
    old, new = (importlib.import_module(f"telenano.{room}") for room in (before, now))
    for name in names.split():
        assert getattr(old, name) is getattr(new, name)
        assert name not in dir(old)


def test_a_name_that_is_not_listed_is_refused_as_python_refuses_it() -> None:
    import telenano.wire

    with pytest.raises(AttributeError, match=r"module 'telenano\.wire' has no attribute 'compse'"):
        telenano.wire.compse  # type: ignore[attr-defined]  # noqa: B018


def test_a_room_imports_nothing_before_a_name_is_used() -> None:
    script = "import sys, telenano.wire; assert not {'ast', 'numpy', 'msgspec', 'pathlib'} & set(sys.modules)"
    subprocess.run([sys.executable, "-S", "-c", f"import sys; sys.path[:] = {sys.path!r}; {script}"], check=True)
