#!/bin/sh
# Print the Python to build the environment with: the best one on this machine that really runs.
# A name on the PATH may be a launcher that fails, so each candidate is executed. Python 3.12 and newer
# come first: they get a newer JAX, which sweeps two to three times faster than the one for 3.11.
#
#     find_python.sh [PYTHON [VERSION]]     this very interpreter, or one of this version only
set -u

CHECK='import sys, venv, ensurepip; sys.exit(not sys.version_info >= (3, 11))'

runs() {
    "$1" -c "$CHECK" >/dev/null 2>&1
}

if [ -n "${1:-}" ]; then
    runs "$1" && { echo "$1"; exit 0; }
    echo "make: PYTHON=$1 does not run, is older than Python 3.11, or has no venv module" >&2
    exit 1
fi

roots="${PYENV_ROOT:-} ${HOME:-}/.pyenv"
command -v pyenv >/dev/null 2>&1 && roots="$roots $(pyenv root 2>/dev/null)"

for version in ${2:-3.13 3.12 3.14 3.11}; do
    runs "python$version" && { command -v "python$version"; exit 0; }
    for root in $roots; do
        for candidate in "$root"/versions/"$version".*/bin/python; do
            runs "$candidate" && { echo "$candidate"; exit 0; }
        done
    done
done
[ -n "${2:-}" ] && exit 1
for name in python3 python; do
    runs "$name" && { command -v "$name"; exit 0; }
done

echo "make: found no Python 3.11 or newer with the venv module. Install one (on Debian and Ubuntu:" >&2
echo "make: apt install python3 python3-venv), or name one: make PYTHON=/path/to/python3.12" >&2
exit 1
