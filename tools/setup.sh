# Sourced by tools/demo and tools/test: brings a fresh Debian or Ubuntu to where edged runs.
# Idempotent and quick the second time. Usage: . tools/setup.sh [run|test]
#
# Leaves an activated environment in .venv and NUMBA_CACHE_DIR set.

set -euo pipefail
EDGED_ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
EDGED_FOR=${1:-run}
cd "$EDGED_ROOT"

say() { printf '\033[1m==>\033[0m %s\n' "$*" >&2; }

apt_install() { # apt_install PACKAGE... ; what is missing, if we may
    local missing=() package
    for package in "$@"; do
        [ "$(dpkg-query -W -f '${Status}' "$package" 2>/dev/null)" = "install ok installed" ] || missing+=("$package")
    done
    [ ${#missing[@]} -gt 0 ] || return 0
    local as_root=()
    if [ "$(id -u)" -ne 0 ]; then
        if command -v sudo >/dev/null && { sudo -n true 2>/dev/null || [ -t 0 ]; }; then
            as_root=(sudo)
        else
            say "not installed, because neither root nor sudo is there: ${missing[*]}"
            return 1
        fi
    fi
    say "installing with apt: ${missing[*]}"
    local apt=("${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq -o Dpkg::Use-Pty=0)
    { "${apt[@]}" install -y --no-install-recommends "${missing[@]}" ||
        { "${apt[@]}" update && "${apt[@]}" install -y --no-install-recommends "${missing[@]}"; }; } >/dev/null 2>"$EDGED_ROOT/.apt.log" ||
        { say "apt could not install them: $(tail -n 1 "$EDGED_ROOT/.apt.log")"; return 1; }
    rm -f "$EDGED_ROOT/.apt.log"
}

versions() { # versions PACKAGE... ; what moves under us, in one line: Python packages are pinned, these are not
    local package found line
    line="Python $("$EDGED_PYTHON" -c 'import platform; print(platform.python_version())'), Linux $(uname -r)"
    for package in "$@"; do
        found=$(dpkg-query -W -f '${Version}' "$package" 2>/dev/null) || true
        line+=", $package ${found:-is not here}"
    done
    say "versions: $line"
}

is_recent() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }

# The distribution's own Python, because python3-gi (and with it Aravis) belongs to it.
find_python() {
    local python
    for python in /usr/bin/python3 /usr/bin/python3.13 /usr/bin/python3.12 /usr/bin/python3.11 "$(command -v python3 || true)"; do
        if [ -n "$python" ] && [ -x "$python" ] && is_recent "$python"; then
            printf '%s\n' "$python"
            return
        fi
    done
    return 1
}

packages=(python3-venv gir1.2-aravis-0.8 python3-gi)
[ "$EDGED_FOR" != test ] || packages+=(mbpoll systemd-container aravis-tools-cli aravis-tools nftables iproute2 openssl libfaketime softhsm2)
if command -v apt-get >/dev/null; then
    apt_install "${packages[@]}" || true
    # each on its own: where a distribution has it as a snap only, the tests in it are skipped, and nothing else is
    [ "$EDGED_FOR" != test ] || apt_install chromium || true
    [ "$EDGED_FOR" != test ] || apt_install firefox-esr || true
    [ "$EDGED_FOR" != test ] || apt_install webkit2gtk-driver xvfb xauth || true
    if ! find_python >/dev/null; then # Ubuntu 22.04 comes with 3.10; its PyGObject must be built for 3.11
        apt_install python3.11 python3.11-venv python3.11-dev gcc pkg-config libgirepository1.0-dev libcairo2-dev || true
    fi
else
    say "no apt-get on this machine: Aravis (gir1.2-aravis-0.8) and PyGObject are left to you"
fi
EDGED_PYTHON=$(find_python) || { say "edged needs Python 3.11 or newer, and none was found"; exit 2; }

pip_install() { .venv/bin/python -m pip install -q --disable-pip-version-check "$@"; }

wanted=$({ cat pyproject.toml requirements/*.txt; "$EDGED_PYTHON" -V; pwd; } | sha256sum | cut -c1-16)
if [ ! -e ".venv/$wanted" ]; then
    if ! .venv/bin/python -c 'import sys' 2>/dev/null || [ "$(readlink -f .venv/bin/python)" != "$(readlink -f "$EDGED_PYTHON")" ]; then
        rm -rf .venv
        say "making .venv from $EDGED_PYTHON"
        "$EDGED_PYTHON" -m venv --system-site-packages .venv
    fi
    say "installing the Python packages of pyproject.toml into .venv (files of requirements/dev.txt)"
    pip_install --only-binary :all: --require-hashes -r requirements/dev.txt
    # there is no wheel of it: the setuptools of dev.txt builds it
    pip_install --require-hashes --no-deps --no-build-isolation --use-pep517 -r requirements/witness.txt
    pip_install --no-deps --no-build-isolation -e .
    rm -f .venv/????????????????
    touch ".venv/$wanted"
fi
if ! .venv/bin/python -c 'import gi' 2>/dev/null && command -v gcc >/dev/null && pkg-config --exists gobject-introspection-1.0 2>/dev/null; then
    say "building PyGObject for $EDGED_PYTHON"
    # what builds comes first: each from requirements/aravis.txt, none by pip's own choice of build tools
    for names in 'meson|meson-python|ninja|packaging|pyproject-metadata' pycairo pygobject; do
        sed -nE "/^($names)==/,/[^\\]\$/p" requirements/aravis.txt >.venv/aravis.txt
        PATH=$PWD/.venv/bin:$PATH pip_install --require-hashes --no-deps --no-build-isolation -r .venv/aravis.txt ||
            { say "PyGObject could not be built"; break; }
    done
fi
.venv/bin/python - <<'PY' || say "Aravis is not here: real and GigE Vision cameras are unavailable, in-process cameras stand in"
import gi
gi.require_version("Aravis", "0.8")
PY

# of servers the programs alone: the packages would run them here
if [ "$EDGED_FOR" = test ] && [ ! -x .venv/bin/prometheus-alertmanager ] && command -v apt-get >/dev/null; then
    say "taking Prometheus, promtool and Alertmanager from Debian's packages"
    unpacked=$(mktemp -d)
    (cd "$unpacked" && apt-get -qq download prometheus prometheus-alertmanager 2>/dev/null &&
        for package in *.deb; do dpkg -x "$package" .; done &&
        install usr/bin/{promtool,prometheus,prometheus-alertmanager} "$EDGED_ROOT/.venv/bin/" &&
        $([ "$(id -u)" = 0 ] || echo sudo -n) install -Dm 644 -t /usr/share/prometheus/alertmanager usr/share/prometheus/alertmanager/*.tmpl) ||
        say "no Prometheus: what is shipped for it is not judged"
    rm -rf "$unpacked"
fi
if [ "$EDGED_FOR" = test ] && [ ! -x .venv/bin/nginx ] && command -v apt-get >/dev/null; then
    say "taking nginx from Debian's packages"
    unpacked=$(mktemp -d)
    # Ubuntu 22.04 has the program in nginx-core
    (cd "$unpacked" && { apt-get -qq download nginx && { apt-get -qq download nginx-core || true; }; } 2>/dev/null &&
        for package in *.deb; do dpkg -x "$package" .; done && install usr/sbin/nginx "$EDGED_ROOT/.venv/bin/") ||
        say "no nginx: releases are served by Python's server alone"
    rm -rf "$unpacked"
fi

# one line in any terminal, `. .venv/bin/activate`, then puts `edged` on the PATH with the kernels that are compiled here
cache="export NUMBA_CACHE_DIR=\"$EDGED_ROOT/.venv/numba-cache\""
grep -qxF "$cache" .venv/bin/activate || printf '%s\n' "$cache" >>.venv/bin/activate
# shellcheck disable=SC1091
. .venv/bin/activate
mkdir -p "$NUMBA_CACHE_DIR"
[ "$EDGED_FOR" != test ] || versions "${packages[@]:1}" chromium firefox-esr webkit2gtk-driver systemd
tools/manual --if-needed || say "the manual could not be built: the status page will say so"
[ "$EDGED_FOR" = test ] || edged warm --if-needed
