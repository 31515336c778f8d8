#!/bin/sh
# The main job from a fresh Debian 12 to a picture:  docs/demo.sh [OUT]
# Installs packages, builds the tools, takes textured models (CC0) from the Debian package sweethome3d-furniture, and
# voxelizes, compresses, measures, packs and renders them. Leaves in OUT (default: out) picture.png, summary.txt,
# report.json, scene.html (the scene in a browser), and every file in between. May be run again: finished packages and builds are kept, OUT's files are made anew.
set -eu
cd "$(dirname -- "$0")/.."
out=${1:-out}
docs/install_packages.sh sweethome3d-furniture

cmake --preset release >build.log 2>&1 || { cat build.log; exit 1; }
cmake --build build --target svo-voxelize svo-compress svo-skeleton svo-pack svo-render svo-dump svo-compare
root=$PWD
bin=$root/build/tools

mkdir -p "$out/reports"
rm -f "$out"/reports/*.json
python3 docs/demo_scene.py /usr/share/sweethome3d/furniture/BlendSwap-CC-0.sh3f "$out"
cd "$out"

run() { # name of the step, tool, arguments...
    step=$1 tool=$2
    shift 2
    echo "$tool $*"
    "$bin/$tool" "$@" --force --report "reports/$step.json"
}
run 1-voxelize svo-voxelize models/chairWithCushion/chairWithCushion.obj -o chair.svo --depth 9
run 2-compress svo-compress chair.svo -o chair.svdag --color deltaE=1 --normal deg=2
run 3-skeleton svo-skeleton models/chairWithCushion/chairWithCushion.obj -o chair.skel --omega 0.03 --glb chair-skeleton.glb
run 4-pack svo-pack scene.json -o scene.svscene --depth 9 --color 10 --normal 16
run 5-render svo-render scene.svscene -o picture.png --size 1280x720 --samples 2
run 6-compare svo-compare chair.svo chair.svdag || [ $? -eq 7 ] # 7: the attributes differ, by as much as was allowed
for f in chair.svo chair.svdag chair.skel scene.svscene; do
    "$bin/svo-dump" --validate "$f"
done
"$bin/svo-dump" --json scene.svscene >scene-dump.json
"$bin/svo-dump" scene.svscene --html scene.html --force >/dev/null
python3 "$root/docs/summarize.py" .
echo "picture: $PWD/picture.png   summary: $PWD/summary.txt   report: $PWD/report.json   to walk around in, with a browser: $PWD/scene.html"
