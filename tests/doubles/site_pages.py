"""What `make site` adds to the pages of docs/: notebooks as pages, the gallery of delay, the other documents.

MkDocs calls the functions that begin with `on_` (mkdocs.yml, `hooks`).
"""

import json
import re
from functools import cache
from pathlib import Path
from posixpath import dirname, join, normpath, relpath
from typing import Any

import nbformat
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter
from telenano_studies.pages.gallery import FOLDER, fragment_of

ROOT = Path(__file__).resolve().parents[2]
# documents beside docs/, which its pages link to; a package that `telenano new` made here is none
_FOLDERS = ("", "services/", "telenano/", "packages/", "packages/telenano-emulators/telenano_emulators/firmware/")
_BESIDE = ("*.md", *(f"{at}*/README.md" for at in _FOLDERS), "proto/*.md")
_OTHERS = {
    str(path.relative_to(ROOT)): path
    for pattern in _BESIDE
    for path in sorted(ROOT.glob(pattern))
    if path.parent.name not in ("docs", "out") and not str(path.relative_to(ROOT)).startswith((".", "telenano-"))
}
# the pictures of such a document
_PICTURES = {str(path.relative_to(ROOT)): path for path in sorted(ROOT.glob("examples/*.png"))}
_PREFIX = "repository/"
# pages whose pictures need the place of the table of contents
_WIDE = {"index.md": ["navigation", "toc"], "gallery.md": ["toc"], "unstable.md": ["toc"]}
# the picture in whose place the site has the gallery of delay itself
_STILL = re.compile(r"^!\[[^\]]*\]\(view/gallery\.png\)$", re.MULTILINE)
_SLIDER = "<!-- the gallery of delay -->"
# a link that is called as the repository calls its file, which a reader of the site does not know
_FILE_NAME = re.compile(r"[\w./-]+\.md")
_FENCE = re.compile(r"(^ *```.*?^ *```)", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\](?:\([^)]*\))?)*)\]\(([^)\s]+)((?:\s+\"[^\"]*\")?)\)")


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add the documents beside docs/ with their pictures, and the notebooks as pages."""
    for name, path in _OTHERS.items():
        files.append(File.generated(config, f"{_PREFIX}{name}", content=path.read_text(encoding="utf-8")))
    for name, path in _PICTURES.items():
        files.append(File.generated(config, f"{_PREFIX}{name}", content=path.read_bytes()))
    for notebook in [file for file in files if file.src_uri.endswith(".ipynb")]:
        page = notebook.src_uri.removesuffix(".ipynb")
        text, figures = converted(Path(str(notebook.abs_src_path)))
        files.append(File.generated(config, f"{page}.md", content=text))
        for name, content in figures.items():
            files.append(File.generated(config, f"{dirname(page)}/{name}", content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Make the links of the repository links of the site, and give wide pages the room of the table of contents."""
    uri = page.file.src_uri
    if uri in _WIDE:
        page.meta["hide"] = _WIDE[uri]
    if uri == "unstable.md":
        markdown = _STILL.sub(_SLIDER, markdown)
    return "".join(
        part if number % 2 else _LINK.sub(lambda found: linked(found, uri), part)
        for number, part in enumerate(_FENCE.split(markdown))
    )


def on_page_content(html: str, **_: Any) -> str:
    """Put the gallery of delay where a page has its mark."""
    if _SLIDER not in html:
        return html
    document = json.loads((FOLDER / "gallery.json").read_text(encoding="utf-8"))
    return html.replace(_SLIDER, fragment_of(document))


def linked(found: re.Match[str], uri: str) -> str:
    """Return a link of a document as the site has it: text alone where it leads to a file that is no document."""
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
    """Return the title of a document by its path in the repository, empty where it has none."""
    path = ROOT / document
    text = path.read_text(encoding="utf-8") if document.endswith(".md") and path.is_file() else ""
    found = re.search(r"^# (.+)$", text, re.MULTILINE)
    return found[1] if found else ""


def converted(path: Path) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as Markdown with what its cells printed, and its figures by file name."""
    notebook = nbformat.read(path, as_version=4)
    text, resources = MarkdownExporter().from_notebook_node(notebook, {"unique_key": path.stem})
    # a table of pandas looks as every other table of the site
    text = re.sub(r"<style scoped>.*?</style>", "", text, flags=re.DOTALL).replace(' border="1" class="dataframe"', "")
    file = f'<a href="{path.name}" download>a notebook</a>'
    link = f"This is {file}, with what it printed. `pip install -e '.[notebooks]'` brings Jupyter."
    head, _, rest = text.lstrip().partition("\n\n")
    return f"{head}\n\n{link}\n\n{rest}", dict(resources["outputs"])
