"""Every numbered statement of the design has a test, and every test names statements that are there."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from requirements import NUMBER, here, problems, statements, table, traced
from support import ROOT


def test_each_requirement_is_traced() -> None:
    assert problems(*here()) == []
    numbers = NUMBER.findall((ROOT / "docs/design.md").read_text(encoding="utf-8"))
    assert numbers == [f"R{number}" for number in range(1, len(numbers) + 1)] and len(numbers) > 30
    assert all(f"| {number} |" in table() for number in numbers)


def test_each_proof_that_is_named_is_run() -> None:
    named = {place for places in here()[1].values() for place in places if place.startswith("proofs/")}
    run = set[str]()
    for name in ("accuracy", "calls", "images", "robust", "sums"):
        module = import_module(f"proofs.{name}")
        claims = (*getattr(module, "OF_THE_CODE", ()), *getattr(module, "OF_THE_NUMBERS", ()))
        contracts = {id(each) for each in getattr(module, "CONTRACTS", {}).values()}
        names = [each.__name__ for each in claims]
        names += [name for name, value in vars(module).items() if id(value) in contracts]
        run |= {f"proofs/{name}.py: {each}" for each in names}
    others = {place for place in named - run if ": test_" not in place}
    tests_of_their_own = {"proofs/calls.py: of_a_message", "proofs/images.py: of_the_way_back"}
    assert others == tests_of_their_own
    assert len(named) > 20


def test_what_is_not_traced_is_told(tmp_path: Path) -> None:
    page = "## 1. Calls\n\nIt counts.<sup>R1</sup> It\nstops.<sup>R2</sup>\n\n1. It halves.<sup>R3</sup>\n"
    assert statements(page) == {"R1": "It counts.", "R2": "It stops.", "R3": "It halves."}
    text = "# design@: R1, R4\n@mark\ndef test_it() -> None:\n    pass\n\n\n# design@: R2\nA = 1\n".replace(
        "@:", ":"
    )
    (tmp_path / "a.py").write_text(text)
    shown = traced([tmp_path / "a.py"], tmp_path)
    assert shown == {"R1": ["a.py: test_it"], "R4": ["a.py: test_it"], "R2": ["a.py: no test"]}
    told = ["R3 has no test: It halves.", "a.py: no test", "a.py: test_it names R4, which is none"]
    assert problems(statements(page), shown) == told
