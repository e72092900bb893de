"""The identity of an entry follows the files of a package that pip has installed to be edited, in an environment."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from telenano.cli.new_package import new_package

IDENTITY = """
from telenano.settings.plugins import installed
row = installed("laws")["mine"]
print(row.package, row.version, row.problem or "-", row.digest)
"""


@pytest.mark.check("pip installs a package into an environment of its own, 4 s")
def test_an_edit_of_an_editable_package_is_another_identity(tmp_path: Path) -> None:
    new_package("law", "mine", tmp_path / "package")
    environment, source = tmp_path / "environment", tmp_path / "package" / "telenano_mine" / "__init__.py"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
    python = environment / "bin" / "python"
    (folder,) = environment.glob("lib/python*/site-packages")
    # The environment has what is installed here, with the projects that are installed to be edited.
    (folder / "here.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    words = ("install", "--no-index", "--no-deps", "--no-build-isolation", "--editable", tmp_path / "package")
    subprocess.run([python, "-m", "pip", *words], env=clean, check=True, capture_output=True)

    def identity() -> str:
        done = subprocess.run([python, "-c", IDENTITY], env=clean, check=True, capture_output=True, text=True)
        *words, digest = done.stdout.split()
        assert words == ["telenano-mine", "0.1.0", "-"]
        return digest

    whole = source.read_text()
    seen = [identity(), identity()]
    source.write_text(f"{whole}# edited\n")
    seen.append(identity())
    (source.parent / "table.csv").write_text("1,2\n")
    seen.append(identity())
    (source.parent / "table.csv").unlink()
    source.write_text(whole)
    seen.append(identity())
    assert [seen.index(each) for each in seen] == [0, 0, 2, 3, 0]
