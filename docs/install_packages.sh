#!/bin/sh
# Install the Debian packages listed in docs/packages.txt and those named as arguments. Does nothing, and needs
# neither root nor network, when all are there already.
set -eu
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
wanted="$(grep -v '^#' "$here/packages.txt" | tr '\n' ' ') $*"
missing=
for package in $wanted; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q '^install ok installed' || missing="$missing $package"
done
[ -n "$missing" ] || exit 0
echo "installing:$missing" >&2
root=
[ "$(id -u)" = 0 ] || root=sudo
export DEBIAN_FRONTEND=noninteractive
$root apt-get update -q >&2
# shellcheck disable=SC2086
$root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $missing >&2
