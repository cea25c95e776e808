# The few commands that people type; each sets up what it needs first. `make` alone lists them.
BIN := .venv/bin
export PATH := $(CURDIR)/$(BIN):$(PATH)
# Tests start hundreds of processes; each would compile all modules anew.
unexport PYTHONDONTWRITEBYTECODE

# What the installed project is built from: the rest is used where it stands.
BUILT_FROM := .ci/setup pyproject.toml CMakeLists.txt c_ref/CMakeLists.txt firmware_py/build_native.py firmware_py/messages.h \
              $(wildcard c_ref/src/*.[ch] host_tools/mcp_asdf_tools/*/arena/*.[ch] host_tools/mcp_asdf_tools/*/engine/*.[ch])
PYTEST := $(BIN)/pytest --numprocesses=auto --dist=worksteal
C_FILES = $(shell git ls-files -co --exclude-standard '*.c' '*.h' '*.cpp' '*.ino')

MINUTES := 5

.PHONY: help setup swarm test verify fuzz lint format crosscheck cost targets socketcan reproducible sbom evidence lowest newest docs clean

help: ## list the commands
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' Makefile | expand -t 18

setup: .venv/ready-to-test ## make .venv with the project and all that tests need

swarm: .venv/ready-to-run ## watch twenty robots, half of them flawed, calibrate themselves, and see what it is good for
	@$(BIN)/mcp-asdf swarm --topology dynamic --filter asdf-minus --flawed 50% --compare

test: .venv/ready-to-test ## run the tests of everything, 2 minutes once set up: C and Python, analysers, documentation
	@rm -rf build/reports
	@$(PYTEST) -m "not slow" --junit-xml=build/reports/pytest.xml

verify: .venv/ready-to-test ## run the slow rest of the tests: every compiler at every level, long runs, guest kernels
	@$(PYTEST) --numprocesses=$$(($$(nproc) + 1)) -m slow --junit-xml=build/reports/verify.xml  # some wait

fuzz: .venv/ready-to-test ## fuzz the C for MINUTES=5 in all: serial lines, datagrams, the radio
	@PYTHONPATH=tests $(BIN)/python -m fuzz --minutes $(MINUTES)

lint: .venv/ready-to-test ## run the analysers and the checks of types and style alone
	@$(BIN)/pytest tests/test_tools.py

format: .venv/ready-to-test ## format all code
	@$(BIN)/ruff check --fix --exit-zero --quiet
	@$(BIN)/ruff format
	@$(BIN)/biome check --write --config-path=.ci host_tools/mcp_asdf_tools/view/page docs/playground docs/javascripts tests/host_tools/view/scripts
	@$(BIN)/clang-format -i $(C_FILES)

crosscheck: .venv/ready-to-run ## compare the C with its mirror, float64 and exact rationals
	@$(BIN)/mcp-asdf crosscheck

cost: .venv/ready-to-test ## measure instructions, cycles, bytes and stack again and write them into the documentation
	@RENEW_GOLDEN_FILES=1 $(BIN)/pytest -m "slow or not slow" tests/benchmarks/test_cost.py -k documentation_have

targets: .venv/ready-to-test ## run the golden vectors on every target, with every compiler and at every level
	@$(PYTEST) tests/targets/test_targets.py

socketcan: .venv/ready-to-test ## test on a real CAN bus of the Linux kernel, in an emulator where this kernel has none
	@$(BIN)/pytest tests/socketcan

reproducible: .venv/ready-to-test ## build library, tables and wheel twice, in two folders, and compare every byte
	@$(BIN)/pytest tests/release -k two_builds

sbom: .venv/ready-to-test ## list what the wheel needs and ships, as CycloneDX, in build/sbom.json
	@PYTHONPATH=tests $(BIN)/python -m release.sbom

evidence: .venv/ready-to-test ## put reports of tests, versions of tools and hashes in build/evidence.tar.gz
	@tests/release/evidence.sh

lowest: .venv/ready-to-test ## install the lowest versions that pyproject.toml allows, in build/lowest, and run the Python tests
	@uv venv --quiet --clear --python 3.11 build/lowest
	@uv pip install --quiet --python build/lowest --resolution lowest-direct --editable '.[all]'
	@uv pip install --quiet --python build/lowest cantools hypothesis pycparser pytest pytest-timeout pytest-xdist
	@build/lowest/bin/pytest -m "not slow" -W default --numprocesses=auto tests/firmware_py tests/host_tools

newest: .venv/ready-to-test ## install all for the newest Python that can be had, in build/newest, and run the quick tests in random order
	@.ci/newest build/newest
	@uv pip install --quiet --python build/newest --editable '.[all]' --group dev
	@build/newest/bin/pytest --numprocesses=auto --dist=worksteal -m "not slow" --shuffle=$$(date +%s)

docs: .venv/ready-to-test ## build the documentation in build/site
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --config-file .ci/mkdocs.yml
	@echo "Open build/site/index.html in a browser; it needs no server."

clean: ## remove everything that was built or installed here
	rm -rf build .venv

.venv/ready-to-run: $(BUILT_FROM)
	@.ci/setup run

.venv/ready-to-test: $(BUILT_FROM)
	@.ci/setup test
