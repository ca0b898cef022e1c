#!/usr/bin/env bash
# Make what a release holds of a tag: release.bash TAG FOLDER
#
# Wheel and sdist of python/, the wheel's bill of materials (CycloneDX: what it installs, with versions and licences),
# the source archive that `colcon build` takes, and their checksums. Nothing is published.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
tag=$1 folder=$(realpath -m "$2")

sources=$(mktemp -d)
trap 'rm -rf "$sources"' EXIT
mkdir -p "$folder"
git archive --prefix="koop-$tag/" --output="$folder/koop-$tag.tar.gz" "$tag"
tar xzf "$folder/koop-$tag.tar.gz" -C "$sources"
./koop shell -s <<EOF
set -e
cd "$sources/koop-$tag/python"
python -m hatchling build -t sdist -d "$folder"
tar xzf "$folder"/koop_esc-*.tar.gz -C "$sources"
cd "$sources"/koop_esc-*/
python -m hatchling build -t wheel -d "$folder"
uv venv --quiet "$sources/env"
uv pip install --quiet --python "$sources/env" --find-links "$folder" "koop-esc==$tag"
env -u PYTHONPATH uvx --quiet --from cyclonedx-bom==7.2.1 cyclonedx-py environment "$sources/env" -o "$folder/koop_esc-$tag.cdx.json"
EOF
[[ -f $folder/koop_esc-$tag-py3-none-any.whl ]] || { echo "the packages of $tag have another version" >&2; exit 1; }
cd "$folder"
sha256sum -- *"$tag"* | tee SHA256SUMS
