"""Every place that cites the paper gives its exact title and its arXiv number."""

from __future__ import annotations

import re

import yaml

from support import ROOT

TITLE = "Adaptive Self-Calibration for Minimalistic Collective Perception by Imperfect Robot Swarms"
NUMBER = "2410.21546"


def test_every_citation_is_right() -> None:
    for name in ("CITATION.cff", "README.md", "c_ref/README.md", "c_ref/src/mcp_asdf.h", "docs/design.md"):
        lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
        text = " ".join(line.lstrip(" /*") for line in lines)
        assert set(re.findall(r"arxiv\D{0,20}(\d{4}\.\d+)", text, re.IGNORECASE)) <= {NUMBER}, name
        assert TITLE in text or NUMBER in text, name


def test_citation_file_names_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    for paper in (citation["preferred-citation"], *citation["references"]):
        assert paper["title"] == TITLE
        assert paper["notes"] == f"arXiv:{NUMBER}"
        assert paper["url"] == f"https://arxiv.org/abs/{NUMBER}"
        assert [author["family-names"] for author in paper["authors"]] == ["Chin", "Pinciroli"]
