"""Build the documentation site: lay out pages, run Sphinx, check the result (`make docs`)."""

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

import api_pages
import html_checks
import markdown_pages

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


def build(out: Path) -> Path:
    """Build the site into a folder, and return its first page; SystemExit where a page has a fault."""
    source, html = out / "source", out / "html"
    for folder in (
        source,
        html,
        out / "doctrees",
    ):  # faults of pages that were read earlier would not be reported
        shutil.rmtree(folder, ignore_errors=True)
    pages = markdown_pages.pages(ROOT) | api_pages.pages(ROOT)
    lay_out(pages, source)
    sphinx = ["-m", "sphinx", "--quiet", "--fail-on-warning", "--keep-going", "--jobs", "2"]
    folders = ["--conf-dir", str(HERE), "--doctree-dir", str(out / "doctrees"), str(source), str(html)]
    if subprocess.run([sys.executable, *sphinx, *folders], check=False).returncode:
        raise SystemExit("The site was not built: mend the pages that are named above.")
    faults = html_checks.faults(html)
    if faults:
        raise SystemExit("\n".join(["The site has faults:", *faults]))
    return html / "index.html"


def lay_out(pages: markdown_pages.Pages, source: Path) -> None:
    """Write pages and copy files into a folder of their own."""
    for name, content in pages.items():
        path = source / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, Path):
            shutil.copyfile(content, path)
        else:
            path.write_text(content, encoding="utf-8")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--out", type=Path, default=ROOT / ".site", help="folder to build in")
    print(build(arguments.parse_args().out.resolve()))
