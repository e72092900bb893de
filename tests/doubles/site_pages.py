"""Build the documentation as a site: `python tests/doubles/site_pages.py FOLDER`.

Zensical reads pages and the navigation of mkdocs.yml from a folder that is written here: docs/, the other documents of
the repository with their pictures, the notebooks with their stored outputs, and the gallery of delay. A missing link
target or picture ends the build.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from posixpath import dirname, join, normpath, relpath

import nbformat
from nbconvert import MarkdownExporter
from telenano_lab.studies.pages.gallery import FOLDER, fragment_of

ROOT = Path(__file__).resolve().parents[2]
# Documents outside docs/ to which its pages link, without packages that `telenano new` made here.
_FOLDERS = ("", "services/", "telenano/", "packages/", "packages/telenano-devices/telenano_devices/handle/firmware/")
_BESIDE = ("*.md", *(f"{at}*/README.md" for at in _FOLDERS), "proto/*.md", "packages/*/*.md", "packages/*/docs/*.md")
_OTHERS = {
    str(path.relative_to(ROOT)): path
    for pattern in _BESIDE
    for path in sorted(ROOT.glob(pattern))
    if path.parent not in (ROOT / "docs", ROOT / "out")
    and not str(path.relative_to(ROOT)).startswith((".", "telenano-"))
}
# Pictures of these documents.
_PICTURES = {
    str(path.relative_to(ROOT)): path
    for pattern in ("examples/*.png", "packages/*/docs/**/*.png", "packages/*/docs/*.svg")
    for path in sorted(ROOT.glob(pattern))
}
_PREFIX = "repository/"
# Pages whose pictures need the space of the table of contents.
_GALLERY = "repository/packages/telenano-lab/docs/gallery.md"
_WIDE = {"index.md": ["navigation", "toc"], _GALLERY: ["toc"], "unstable.md": ["toc"]}
# The picture that the site replaces by the interactive gallery of delay.
_STILL = re.compile(r"^!\[[^\]]*\]\(view/gallery\.png\)$", re.MULTILINE)
_SLIDER = "<!-- the gallery of delay -->"
# Text of a link that is the name of a file of the repository, which readers of the site do not know.
_FILE_NAME = re.compile(r"[\w./-]+\.md")
_FENCE = re.compile(r"(^ *```.*?^ *```)", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\](?:\([^)]*\))?)*)\]\(([^)\s]+)((?:\s+\"[^\"]*\")?)\)")


def build(out: Path) -> None:
    """Build the site into a folder, which is replaced.

    Raises:
        subprocess.CalledProcessError: A page has a link or a picture whose target is missing.
    """
    with tempfile.TemporaryDirectory() as name:
        source = Path(name)
        write_pages(source / "docs")
        navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
        # The reference documents the modules of the repository.
        settings = navigation.replace("paths: [.]", f"paths: [{json.dumps(str(ROOT))}]")
        (source / "mkdocs.yml").write_text(settings, encoding="utf-8")
        subprocess.run([sys.executable, "-m", "zensical", "build", "--strict", "--clean"], cwd=source, check=True)
        for page in (source / "site").rglob("*.html"):
            text = page.read_text(encoding="utf-8")
            if _SLIDER in text:
                gallery = json.loads((FOLDER / "gallery.json").read_text(encoding="utf-8"))
                page.write_text(text.replace(_SLIDER, fragment_of(gallery)), encoding="utf-8")
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(source / "site", out)


def write_pages(folder: Path) -> None:
    """Write every page of the site as Markdown, with its pictures, into a folder."""
    shutil.copytree(ROOT / "docs", folder)
    for notebook in sorted(folder.rglob("*.ipynb")):
        text, figures = converted(notebook)
        notebook.with_suffix(".md").write_text(text, encoding="utf-8")
        for name, content in figures.items():
            (notebook.parent / name).write_bytes(content)
    for page in sorted(folder.rglob("*.md")):
        uri = str(page.relative_to(folder))
        page.write_text(page_of(page.read_text(encoding="utf-8"), uri), encoding="utf-8")
    for name, path in _OTHERS.items():
        page = folder / _PREFIX / name
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(page_of(path.read_text(encoding="utf-8"), f"{_PREFIX}{name}"), encoding="utf-8")
    for name, path in _PICTURES.items():
        (folder / _PREFIX / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, folder / _PREFIX / name)


def page_of(markdown: str, uri: str) -> str:
    """Return a document adapted for the site: links to its pages, wide pages without a table of contents."""
    head = f"---\nhide: [{', '.join(_WIDE[uri])}]\n---\n" if uri in _WIDE else ""
    if uri == "unstable.md":
        markdown = _STILL.sub(_SLIDER, markdown)
    return head + "".join(
        part if number % 2 else _LINK.sub(lambda found: linked(found, uri), part)
        for number, part in enumerate(_FENCE.split(markdown))
    )


def linked(found: re.Match[str], uri: str) -> str:
    """Return a link of a document adapted for the site; only its text if it leads to a file that is no document."""
    image, text, target, title = found.groups()
    if re.match(r"[a-z]+:|#", target):
        return found[0]
    path, hash_, anchor = target.partition("#")
    origin = uri.removeprefix(_PREFIX) if uri.startswith(_PREFIX) else f"docs/{uri}"
    there = normpath(join(dirname(origin), path))
    if _FILE_NAME.fullmatch(text):
        text = title_of(there) or text
    if there.startswith("docs/"):
        there = there.removeprefix("docs/").replace(".ipynb", ".md")
    elif there in _OTHERS or there in _PICTURES:
        there = f"{_PREFIX}{there}"
    else:
        return text
    return f"{image}[{text}]({relpath(there, dirname(uri) or '.')}{hash_}{anchor}{title})"


@cache
def title_of(document: str) -> str:
    """Return the title of a document at a path in the repository; empty if it has none."""
    path = ROOT / document
    text = path.read_text(encoding="utf-8") if document.endswith(".md") and path.is_file() else ""
    found = re.search(r"^# (.+)$", text, re.MULTILINE)
    return found[1] if found else ""


def converted(path: Path) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as Markdown with the outputs of its cells, and its figures by file name."""
    notebook = nbformat.read(path, as_version=4)
    text, resources = MarkdownExporter().from_notebook_node(notebook, {"unique_key": path.stem})
    # Remove the style of pandas tables, so that they look like every other table of the site.
    text = re.sub(r"<style scoped>.*?</style>", "", text, flags=re.DOTALL).replace(' border="1" class="dataframe"', "")
    file = f'<a href="{path.name}" download>a notebook</a>'
    link = f"This is {file}, with what it printed. `pip install -e '.[notebooks]'` brings Jupyter."
    head, _, rest = text.lstrip().partition("\n\n")
    return f"{head}\n\n{link}\n\n{rest}", dict(resources["outputs"])


if __name__ == "__main__":
    build(Path(sys.argv[1]))
