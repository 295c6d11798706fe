#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes .venv at the repository root: interpreter, dependencies, messages, this package.
#
# Run by `make setup`. Each step is done again only when what it reads has changed. One line for
# each step; details are in .venv/setup.log. PYTHON names an interpreter (3.11 to 3.13).
# ROS 2 Jazzy comes from where it is sourced (ROS_DISTRO is set), else from Python wheels.
# LOCKED=1 installs what requirements.lock pins, by hash, in place of the newest that fit.
# SETUP_CELL=1 (`make setup-cell`) installs what counting takes, without torch, simulation and
# tests; a .venv made so stays so.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root=$PWD
venv=$root/.venv
log=$venv/setup.log
exec 9<"$root/scripts/setup.sh" && flock 9  # one set-up at a time

# The wheels mark a process whose library path they have set; another venv's mark is not ours.
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE VIRTUAL_ENV PYTHONHOME

fail() {
  echo "setup: FAILED: $*" >&2
  exit 1
}

# What pip and CMake say after the cause of a failure.
boilerplate='subprocess-exited|problem with pip|(installable|building|Building) wheel|error code'
boilerplate+='|metadata-generation|Configuring incomplete|^error: metadata|Error while generating'

step() {  # step NAME COMMAND...
  local name=$1 start=$SECONDS why
  shift
  printf 'setup: %s ... ' "$name"
  printf '\n=== %s: %s\n' "$name" "$*" >>"$log"
  if "$@" >>"$log" 2>&1 </dev/null; then
    echo "done ($((SECONDS - start)) s)"
  else
    echo "FAILED"
    why=$(sed '1,/^=== '"${name//\//.}"'/d' "$log" |
          grep -iE 'error|fatal|cannot|not found|no space' | grep -vE "$boilerplate" |
          tail -n 1 | sed 's/^ *//' | cut -c 1-200 || true)
    fail "$name: ${why:-no error message}; log: .venv/setup.log"
  fi
}

key() {  # key WORD... FILE_OR_FOLDER...: one hash of words and contents
  local item
  for item in "$@"; do
    if [[ -e $item ]]; then
      find "$item" -type f -not -path '*/__pycache__/*' -print0 | sort -z | xargs -0 -r sha256sum
    else
      echo "$item"
    fi
  done | sha256sum | cut -d ' ' -f 1
}

changed() { [[ "$(cat "$venv/stamps/$1" 2>/dev/null)" != "$2" ]]; }  # changed STAMP KEY
stamp() { echo "$2" >"$venv/stamps/$1"; }                            # stamp STAMP KEY

# --- interpreter ---------------------------------------------------------------------------

supported() {
  "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null
}

complete() {  # has what a venv and the message build need
  "$1" -c 'import ensurepip, os, sys, sysconfig
sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))' 2>/dev/null
}

candidates() {
  local version
  for version in 3.11 3.12 3.13; do
    command -v "python$version" || true
    compgen -G "${PYENV_ROOT:-$HOME/.pyenv}/versions/$version.*/bin/python$version" || true
    compgen -G "$HOME/.local/share/uv/python/cpython-$version.*/bin/python$version" || true
  done
  command -v python3 || true
}

find_python() {
  local candidate
  if [[ -n ${PYTHON:-} ]]; then
    candidate=$(command -v "$PYTHON") || fail "PYTHON=$PYTHON is not there"
    supported "$candidate" || fail "PYTHON=$PYTHON is $("$candidate" --version 2>&1);" \
                                   "expected Python 3.11 to 3.13"
    echo "$candidate"
  elif [[ $mode == sourced ]]; then
    for candidate in $(command -v python3) /usr/bin/python3 /usr/bin/python3.12; do
      if "$candidate" -c 'import rclpy' 2>/dev/null; then echo "$candidate"; return; fi
    done
    fail "no python3 can import rclpy although ROS_DISTRO=$ROS_DISTRO is set; expected" \
         "the interpreter of ROS 2 (Python 3.12 on Ubuntu 24.04)"
  elif [[ -x ${made_with:-} ]]; then
    echo "$made_with"
  else
    local found
    mapfile -t found < <(candidates)
    for candidate in "${found[@]}"; do
      if supported "$candidate" && complete "$candidate"; then echo "$candidate"; return; fi
    done
    for candidate in "${found[@]}"; do
      if supported "$candidate"; then echo "$candidate"; return; fi
    done
    fail "no Python found; expected 3.11 to 3.13 (PYTHON=/path/to/python names one)"
  fi
}

case ${ROS_DISTRO:-} in
  "") mode=wheels ;;
  jazzy) mode=sourced ;;
  *) fail "ROS_DISTRO is $ROS_DISTRO; expected jazzy, or a shell without ROS" ;;
esac
if [[ $mode == wheels ]]; then
  unset PYTHONPATH  # of some other environment
  [[ $(uname -sm) == "Linux x86_64" ]] || fail "this is $(uname -sm); ROS 2 comes as wheels for" \
    "Linux x86_64 only: source ROS 2 Jazzy (Ubuntu 24.04) and run again"
fi

made_with= made_mode=
if [[ -f $venv/stamps/environment ]]; then
  { read -r made_with; read -r made_mode; } <"$venv/stamps/environment"
  if [[ $made_mode != "$mode" ]]; then
    if [[ $mode == wheels ]]; then
      fail ".venv was made with ROS 2 sourced and now it is not; source it, or start anew" \
           "with 'make clean'"
    fi
    fail ".venv was made with ROS 2 from wheels and now ROS 2 is sourced; open a shell without" \
         "it, or start anew with 'make clean'"
  fi
fi
python=$(find_python)
python=$("$python" -c 'import os, sys; print(os.path.realpath(sys.executable))')
version=$("$python" -c 'import platform; print(platform.python_version())')
if [[ $mode == wheels ]]; then where="ROS 2 from wheels"; else where="ROS 2 as sourced"; fi
echo "setup: Python $version ($python), $where"

# --- system libraries ----------------------------------------------------------------------

missing_packages() {
  "$python" - <<'PY'
import ctypes, importlib.util, os, shutil, sys, sysconfig

missing = []
for library, package in (("libusb-1.0.so.0", "libusb-1.0-0"), ("libGL.so.1", "libgl1"),
                         ("libgomp.so.1", "libgomp1"), ("libEGL.so.1", "libegl1"),
                         ("libidn2.so.0", "libidn2-0")):
    try:
        ctypes.CDLL(library)
    except OSError:
        missing.append(package)
for program, package in (("c++", "g++"), ("make", "make")):
    if not shutil.which(program):
        missing.append(package)
name = f"python3.{sys.version_info[1]}"
if not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")):
    missing.append(f"{name}-dev")
if not importlib.util.find_spec("ensurepip"):
    missing.append(f"{name}-venv")
print(*missing)
PY
}

install_packages() {
  export DEBIAN_FRONTEND=noninteractive
  "$@" apt-get update && "$@" apt-get install -y --no-install-recommends $packages
}

mkdir -p "$venv/stamps"
touch "$venv/COLCON_IGNORE"
packages=$(missing_packages)
if [[ -n $packages ]]; then
  as_root=()
  [[ $(id -u) == 0 ]] || as_root=(sudo -n)
  line="sudo apt-get update && sudo apt-get install -y $packages"
  command -v apt-get >/dev/null ||
    fail "missing system packages (names of Debian and Ubuntu): $packages"
  if [[ $(id -u) != 0 ]] && ! sudo -n true 2>/dev/null; then
    fail "missing system packages; install them and run again: $line"
  fi
  step "system packages $packages" install_packages "${as_root[@]}"
  packages=$(missing_packages)
  [[ -z $packages ]] || fail "still missing after installing: $packages; by hand: $line"
fi

# --- environment and dependencies ----------------------------------------------------------

install() {  # uv is fast; pip is always there
  if [[ -x $venv/bin/uv ]] && "$venv/bin/uv" pip install --python "$venv/bin/python" "$@"; then
    return
  fi
  echo "uv could not; trying pip"
  "$venv/bin/python" -m pip install --disable-pip-version-check "$@"
}

make_venv() {
  local options=()
  [[ $mode == wheels ]] || options=(--system-site-packages)
  rm -rf "$venv"/{bin,include,lib,lib64,share,etc,stamps,pyvenv.cfg}
  "$python" -m venv "${options[@]}" "$venv" || return
  mkdir "$venv/stamps"
  "$venv/bin/python" -m pip install --disable-pip-version-check uv ||
    echo "no uv; pip does its work"
}

install_dependencies() {  # setuptools first: it reads setup.py, and Python 3.12 comes without
  if [[ -n ${LOCKED:-} ]]; then
    install --require-hashes -r requirements.lock
    return
  fi
  install "$setuptools" wheel || return
  "$venv/bin/python" -c 'import sys, setup
requires = setup.cell_requires() if sys.argv[1] else setup.REQUIRES
print(*requires, *(line for extra in sys.argv[2:] for line in setup.EXTRAS[extra]), sep="\n")
' "$cell" $extras >"$venv/requirements.txt" && install -r "$venv/requirements.txt"
}

install_package() {  # the commands; all else is used where it lies
  "$venv/bin/python" -m pip install --disable-pip-version-check --no-index --no-deps \
    --no-build-isolation --use-pep517 -e . || return
  [[ $mode == sourced ]] || link_package  # colcon does it there
}

link_package() {  # puts the package where ros2 run and ros2 launch look; pip -e does not
  local share=$venv/share/stack_counter nodes=$venv/lib/stack_counter
  local index=$venv/share/ament_index/resource_index/packages
  mkdir -p "$share" "$nodes" "$index" || return
  ln -sfn "$root"/{package.xml,config,launch} "$share" || return
  ln -sfn "$root/resource/stack_counter" "$index" || return
  ln -sfn "$venv"/bin/{collector,reconstructor,counter} "$nodes" || return
  cat >"$venv/ros.bash" <<SH
# ROS 2 comes from the environment's own wheels; its tools look for packages here.
export AMENT_PREFIX_PATH="$venv\${AMENT_PREFIX_PATH:+:\$AMENT_PREFIX_PATH}"
SH
}

# What is installed: all of it, or what counting takes. The choice stays until `make clean`.
cell=
if [[ ${SETUP_CELL:-} == 1 || -f $venv/cell ]]; then cell=1; fi
everything="sim train models robot cad pictures view archive mqtt opcua docs test"
if [[ -n $cell ]]; then
  [[ -z ${LOCKED:-} ]] || fail "LOCKED=$LOCKED for a cell; expected one of both:" \
                               "requirements.lock has all packages"
  [[ ! -f $venv/stamps/environment || -f $venv/cell ]] ||
    fail ".venv was begun with everything; 'make clean' and run again for a cell"
  export SETUP_CELL=1  # setup.py reads it
  everything="robot mqtt opcua"
  touch "$venv/cell"
fi
if [[ $mode == wheels ]]; then
  extras="wheels $everything"
  setuptools="setuptools>=77"
else
  extras="sourced $everything"
  setuptools="setuptools>=70,<80"  # colcon calls setup.py in ways that later ones dropped
fi

environment=$(printf '%s\n' "$python" "$mode" "$version" "$root")
if changed environment "$environment" || [[ ! -x $venv/bin/python ]]; then
  step "virtual environment .venv" make_venv
  stamp environment "$environment"
fi

lock=
if [[ -n ${LOCKED:-} ]]; then
  [[ $mode == wheels ]] || fail "LOCKED=$LOCKED and ROS 2 is sourced; expected a shell without" \
                                "it: requirements.lock has ROS 2 as wheels"
  lock=requirements.lock
fi
dependencies=$(key setup.py scripts/setup.sh $lock)
package=$(key "$dependencies" setup.cfg package.xml resource config $(compgen -G launch || true))
if changed dependencies "$dependencies"; then
  step "dependencies (minutes and some gigabytes the first time)" install_dependencies
  stamp dependencies "$dependencies"
fi
if changed package "$package"; then
  step "package stack_counter" install_package
  stamp package "$package"
fi

# --- messages ------------------------------------------------------------------------------

build_wheel() {  # build_wheel FOLDER: an interface package into the venv, against the wheels
  PATH=$venv/bin:$PATH CMAKE_PREFIX_PATH=$venv AMENT_PREFIX_PATH=$venv \
    "$venv/bin/python" -m pip install --disable-pip-version-check --no-index --no-deps \
    --no-build-isolation --force-reinstall "./$1"
}

build_with_colcon() {  # the venv's Python, so that the nodes find what is installed there
  "$venv/bin/python" -m colcon build --base-paths . msg_defs || return
  cat >"$venv/bin/stack-counter" <<SH
#!/usr/bin/env bash
# Written by scripts/setup.sh: the command with ROS 2 and this package's messages on its paths.
source "$root/install/setup.bash"
exec "$venv/bin/python" -c 'import sys; from stack_counter.cli import main; sys.exit(main())' "\$@"
SH
}

built_on=$(ls "$venv"/lib/python3*/site-packages | grep -E '^ros_.*dist-info' || true)
messages=$(key "$environment" "$built_on" msg_defs)
[[ $mode == wheels ]] || messages=$(key "$messages" "$package" stack_counter)  # colcon copies code
if changed messages "$messages"; then
  if [[ $mode == sourced ]]; then
    step "messages and nodes (colcon)" build_with_colcon
    echo "source '$root/install/setup.bash'" >"$venv/ros.bash"
  else
    step "messages stack_counter_msgs" build_wheel msg_defs
    if [[ -f $venv/stamps/tf2_msgs ]] || ! "$venv/bin/python" -c 'import tf2_msgs.msg' 2>/dev/null
    then
      step "messages tf2_msgs" build_wheel msg_defs/tf2_msgs_wheel
      stamp tf2_msgs ours
    fi
  fi
  stamp messages "$messages"
fi

# --- bytecode ------------------------------------------------------------------------------

# Without it every start of a node compiles some thousand files, wherever Python does not write
# what it compiles: as another user, in an image, with PYTHONDONTWRITEBYTECODE. uv leaves none.
compile_libraries() {  # templates of some packages are no Python, and never imported
  "$venv/bin/python" -m compileall -qq -j 0 "$venv"/lib/python3*/site-packages || true
}

libraries=$(key "$dependencies" "$messages")
if changed bytecode "$libraries"; then
  step "bytecode of the libraries" compile_libraries
  stamp bytecode "$libraries"
fi
"$venv/bin/python" -m compileall -qq stack_counter || true  # 0.2 s where nothing changed

# --- does it work? -------------------------------------------------------------------------

check() {  # in a shell of its own: ROS's set-up files read variables that may be unset
  bash -c 'source "$1/ros.bash" && "$1/bin/python" -c "$2"' check "$venv" '
import rclpy, stack_counter_msgs.msg, tf2_msgs.msg
import cv2, onnxruntime, open3d'"$([[ -n $cell ]] || echo ', torch')"
}

works=$(key "$dependencies" "$messages" "$package")
if changed works "$works"; then
  step "check of the imports" check
  stamp works "$works"
fi
echo "setup: .venv is ready${cell:+, for a cell that only counts} ($SECONDS s)"
