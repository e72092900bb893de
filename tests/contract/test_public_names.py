"""What packages use of the project is public, what is public is used, and there is not more of it than stated."""

import pytest
from public_names import API, PACKAGES, ROOT, at_most, imports_in, offered, used_by, used_by_strangers


def used_by_the_rest() -> set[tuple[str, str]]:
    """Return what the core and the tests of packages take from faces, and the tests of what a stranger tests with."""
    files = [*ROOT.glob("telenano/**/*.py"), *ROOT.glob("services/**/*.py"), *ROOT.glob("packages/*/tests/**/*.py")]
    files += ROOT.glob("tests/**/*.py")
    return {name for path in files for name in imports_in(path.read_text("utf-8"))}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_uses_public_names_alone(package: str) -> None:
    inner = [
        f"{module}.{name}"
        for module, name in sorted(used_by(package))
        if name not in offered().get(module, ()) and f"{module}.{name}" not in offered()
    ]
    assert not inner, "name it on the face of its room, or move what only this package uses into the package"


def test_every_public_name_is_used_outside_of_its_room() -> None:
    used = {name for package in PACKAGES for name in used_by(package)} | used_by_strangers() | used_by_the_rest()
    others = {module: names for module, names in offered().items() if module != API}
    unused = [f"{module}.{name}" for module, names in others.items() for name in names if (module, name) not in used]
    assert sorted(unused) == [], "take it off the face: it is public for nobody"


def test_there_are_no_more_public_names_than_stated() -> None:
    names = sum(map(len, offered().values()))
    assert names <= at_most(), (
        f"{names} public names, {names - at_most()} more than public-names-at-most of pyproject.toml: let an object "
        "that is public already carry the new one, or move what a single package uses into the package"
    )


def test_names_are_found_where_modules_are_read_and_where_they_are_imported_from() -> None:
    text = "import telenano\nfrom telenano.laws import ranges as r\nfrom telenano.wire import decode\n"
    text += "r.NARROW\ntelenano.simulate()"
    assert {("telenano.laws", "ranges"), ("telenano.laws.ranges", "NARROW"), ("telenano.wire", "decode")} < set(
        imports_in(text)
    )
    assert (API, "simulate") in set(imports_in(text))
    assert sum(map(len, offered().values())) > 100 and {"telenano.wire", "telenano.extend.laws"} < offered().keys()
