#!/usr/bin/env bash
# Put the evidence of a release into one archive, build/evidence.tar.gz: the reports of make test and make verify, the
# commit and what differs from it, SHA-256 of each file, the versions of tools and packages, the bill of materials.
# Arguments, if any: the folder of the reports, the archive, and the Python whose packages are listed.
set -euo pipefail
cd "$(dirname "$0")/../.."
reports=${1:-build/reports} archive=${2:-build/evidence.tar.gz} python=${3:-.venv/bin/python}
compgen -G "$reports/*.xml" >/dev/null || { echo "no reports in $reports; run make test and make verify first"; exit 1; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cp "$reports"/*.xml "$folder"
{ git log -1 --format='%H %cI' && git status --porcelain; } >"$folder/commit.txt"
git ls-files -z | xargs -0 sha256sum >"$folder/SHA256SUMS"
for tool in gcc clang clang-19 tcc rustc arm-none-eabi-gcc avr-gcc riscv64-unknown-elf-gcc arm-linux-gnueabihf-gcc \
    aarch64-linux-gnu-gcc s390x-linux-gnu-gcc qemu-system-arm qemu-system-riscv32 qemu-s390x frama-c cppcheck cmake afl-fuzz node \
    tshark; do
    echo "$tool: $({ "$tool" --version 2>&1 || true; } | head -1)"
done >"$folder/tools.txt"
"$python" -m pip --disable-pip-version-check freeze >"$folder/packages.txt"
PYTHONPATH=tests "$python" -m release.sbom "$folder/sbom.json" >/dev/null
tar --create --gzip --file="$archive" --directory="$folder" .
sha256sum "$archive"
