#!/usr/bin/env bash
# The one door to polar_nav. On first use it makes .venv beside this file and installs everything
# into it; after that it only compares a stamp and runs the command line tool.
#
#   ./polar --help     what there is to do
#   ./polar lock       write requirements.lock anew from requirements.in
#
# POLAR_PYTHON=python3.12 ./polar ...   names the Python that makes .venv (3.11 or 3.12).
set -euo pipefail

root=$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")
venv=$root/.venv
stamp=$venv/.polar_setup # one line "step key" for each step that is done
log=$venv/setup.log
tools=$root/polar_nav_tools/polar_nav_tools
PATH=${PATH//"$venv/bin:"/} # an activated .venv is not the Python that makes .venv

say() { printf 'polar: %s\n' "$*" >&2; }
die() { say "$@"; exit 1; }

# A ROS 2 that is sourced (apt, a workspace, another environment) stays outside: its Python packages
# and libraries have other versions than ours. Domain and discovery settings are left as they are.
leave_other_ros() {
  local dir kept=
  sourced=${ROS_DISTRO:-}
  unset PYTHONPATH PYTHONHOME _ROS_WHEELS_BOOTSTRAP_COMPLETE ROS_DISTRO ROS_VERSION
  unset ROS_PYTHON_VERSION AMENT_PREFIX_PATH AMENT_CURRENT_PREFIX CMAKE_PREFIX_PATH
  unset COLCON_PREFIX_PATH PIP_TARGET PIP_PREFIX
  export PIP_USER=0 PIP_DISABLE_PIP_VERSION_CHECK=1
  if [[ -n ${LD_LIBRARY_PATH:-} ]]; then
    while IFS= read -r -d : dir; do
      case $dir in '' | *.libs | "$venv"/*) continue ;; esac
      compgen -G "$dir/librcl*.so*" >/dev/null && continue
      compgen -G "$dir/lib*__rosidl_*.so*" >/dev/null && continue
      kept+=${kept:+:}$dir
    done <<<"$LD_LIBRARY_PATH:"
    export LD_LIBRARY_PATH=$kept
    [[ -n $kept ]] || unset LD_LIBRARY_PATH
  fi
  if [[ ${RMW_IMPLEMENTATION:-rmw_fastrtps_cpp} != rmw_fastrtps_cpp ]]; then
    say "RMW_IMPLEMENTATION=$RMW_IMPLEMENTATION is left aside: this environment has Fast DDS only"
    unset RMW_IMPLEMENTATION
  fi
}

enter_environment() {
  export VIRTUAL_ENV=$venv PATH=$venv/bin:$PATH AMENT_PREFIX_PATH=$venv
  if [[ -z ${ROS_HOME:-}${ROS_LOG_DIR:-} && ! -w ${HOME:-} ]]; then
    export ROS_HOME=${TMPDIR:-/tmp}/polar_nav-$UID # rclpy cannot start without a place for its log
  fi
}

key() { (cd "$root" && sha256sum -- "$@" | sha256sum | cut -c 1-32); }
files() { (cd "$root" && find "$@" -type f ! -name '*.pyc' | LC_ALL=C sort); }

declare -A want
# What the finished environment would be stamped with. The first step also changes when the tree is
# moved or the system replaces its Python; then nothing of the old environment can stay.
read_want() {
  local -a messages setups kernels
  mapfile -t messages < <(files polar_nav_msgs)
  mapfile -t setups < <(files . -maxdepth 2 -path './polar_nav_*/setup.*')
  mapfile -t kernels < <(files polar_nav_core/polar_nav_core/{kernels,warm.py})
  want[environment]="in $root with $([[ ! -x $venv/bin/python ]] || readlink -f "$venv/bin/python")"
  want[requirements]=$(key requirements.lock)
  want[messages]=$(key requirements.lock "${messages[@]}")
  want[packages]=$(key "$tools/development/environment.py" "${setups[@]}")
  want[kernels]=$(key requirements.lock "${kernels[@]}")
}

have() {
  local lines=
  [[ -e $stamp ]] && lines=$'\n'$(<"$stamp")$'\n'
  [[ $lines == *$'\n'"$1 ${2-}"* ]]
}
is_done() { have "$1" "${want[$1]}"$'\n'; }
all_done() {
  is_done environment && is_done requirements && is_done messages && is_done packages &&
    is_done kernels
}

# Replace the line of one step; without a key only remove it.
mark() {
  { grep -v "^$1 " "$stamp" || true; } >"$stamp.new"
  [[ $# -lt 2 ]] || echo "$1 $2" >>"$stamp.new"
  mv -f -- "$stamp.new" "$stamp"
}

find_python() {
  local candidate version seen='' candidates=(python3 python3.12 python3.11)
  [[ -z ${POLAR_PYTHON:-} ]] || candidates=("$POLAR_PYTHON")
  for candidate in "${candidates[@]}"; do
    if ! version=$("$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>&1); then
      # A shim, say, of a Python that is not there: its own words explain more than ours.
      [[ -z ${POLAR_PYTHON:-} ]] || die "POLAR_PYTHON=$POLAR_PYTHON does not run: ${version##*$'\n'}"
      continue
    fi
    case $version in
      3.11 | 3.12) python=$candidate && return ;;
      *) seen+=" ($candidate is $version)" ;;
    esac
  done
  if [[ -n ${POLAR_PYTHON:-} ]]; then
    die "POLAR_PYTHON=$POLAR_PYTHON is not a Python 3.11 or 3.12$seen"
  fi
  die "no Python 3.11 or 3.12 found$seen. Debian 12, Ubuntu 24.04:" \
    "apt install python3 python3-venv python3-dev g++; elsewhere name one with POLAR_PYTHON="
}

# Name all that is missing at once.
check_machine() {
  local packages=() name=python3 version
  if is_done environment; then python=$venv/bin/python; else find_python; fi
  version=$("$python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
  [[ $(command -v "$python") == /usr/bin/python3 ]] || name=$version
  "$python" -c 'import ensurepip, venv' 2>/dev/null || packages+=("$name-venv")
  "$python" - <<'END' || packages+=("$name-dev")
import os, sys, sysconfig
sys.exit(not os.path.exists(os.path.join(sysconfig.get_path('include'), 'Python.h')))
END
  { command -v "${CC:-cc}" && command -v "${CXX:-c++}"; } >/dev/null || packages+=(g++)
  ((${#packages[@]} == 0)) ||
    die "missing for the set-up with $version: ${packages[*]}. Debian, Ubuntu:" \
      "apt install ${packages[*]}"
  [[ $(uname -sm) == 'Linux x86_64' ]] ||
    say "$(uname -sm): the ROS 2 wheels are known to work on Linux x86_64; trying"
}

make_environment() {
  : >"$stamp"
  find "$venv" -mindepth 1 -maxdepth 1 ! -path "$stamp" ! -path "$log" -exec rm -rf -- {} +
  : >"$venv/COLCON_IGNORE"
  "$python" -m venv "$venv"
}

# One source archive is among the requirements (empy); --no-build-isolation builds it with the pinned
# setuptools instead of the newest.
pip_install() {
  local pip=("$venv/bin/python" -m pip install --no-deps --no-input --progress-bar off)
  pip+=(--only-binary ':all:' --no-binary empy)
  pip+=(--require-hashes)
  "${pip[@]}" "$@"
}

# Pins of the lock file with their hashes.
pins_of() {
  local name
  for name in "$@"; do sed -n "/^$name==/,/[^\\\\]\$/p" "$root/requirements.lock"; done
}

# What kernels are compiled with comes before all others: compile_early waits for it.
install_requirements() {
  pip_install -r <(pins_of numba llvmlite numpy scipy gsw pygeomag pyyaml)
  echo 'the compiler is there' >"$early_file"
  pip_install -r <(pins_of setuptools)
  pip_install --no-build-isolation --use-pep517 -r "$root/requirements.lock"
}

build_messages() {
  PATH=$venv/bin:$PATH "$venv/bin/python" -m pip install --no-deps --no-build-isolation \
    --no-input --force-reinstall "$root/polar_nav_msgs/tf2_msgs" "$root/polar_nav_msgs"
}

link_packages() { "$venv/bin/python" "$tools/development/environment.py" link; }

warm() {
  [[ ! -e $root/polar_nav_core/polar_nav_core/warm.py ]] ||
    "$venv/bin/python" -P -m polar_nav_core.warm
}

# Compile kernels as soon as the compiler is installed, beside the other steps: those leave a core
# idle for most of the time. The step for kernels waits for it, and does it all where this failed.
early=
early_file=$venv/early
compile_early() {
  rm -f -- "$early_file"
  set -m
  {
    until [[ -e $early_file ]]; do
      kill -0 $$ 2>/dev/null || exit 1
      sleep 0.2
    done
    PYTHONPATH=$root/polar_nav_core warm && echo 'kernels are compiled' >"$early_file"
  } >>"$log" 2>&1 </dev/null &
  early=$!
  set +m
}

end_early() {
  [[ -n $early ]] || return 0
  kill -TERM -- "-$early" 2>/dev/null || true
  wait "$early" 2>/dev/null || true
  early=
}

compile_kernels() {
  if [[ -n $early ]]; then
    while kill -0 "$early" 2>/dev/null; do sleep 0.1; done
    ! grep -q '^kernels are compiled$' "$early_file" || return 0
  fi
  warm
}

# How far a step is: kernels compiled; packages looked up, later packages unpacked.
progress() {
  local total looked_up unpacked
  if [[ $1 == kernels ]]; then
    sed -n 's/^\([0-9]* of [0-9]*\) kernels are compiled$/, \1 kernels/p' "$log" | tail -n 1
  fi
  [[ $1 == requirements ]] || return 0
  total=$(grep -c "==" "$root/requirements.lock")
  looked_up=$(grep '^Collecting' "$log" | sort -u | wc -l)
  unpacked=$(find "$venv"/lib/python3*/site-packages -maxdepth 1 -name '*.dist-info' ! -name 'pip-*' | wc -l)
  if [[ $(grep '^Collecting\|^Installing collected packages: .*,' "$log" | tail -n 1) == I* ]]; then
    echo ", $unpacked of $total unpacked"
  else
    echo ", $looked_up of $total fetched"
  fi
}

child=
stop() {
  trap - INT TERM HUP
  if [[ -n $child ]]; then
    kill -TERM -- "-$child" 2>/dev/null || true
    wait "$child" 2>/dev/null || true
  fi
  [[ ! -t 2 ]] || echo >&2
  say "set-up interrupted; the next call completes it"
  exit 130
}

# Run one step in the background, in a process group of its own, so that Ctrl-C ends compilers too.
number=0
run_step() { # name, title, command
  local name=$1 title=$2 command=$3 start=$SECONDS line told=0
  number=$((number + 1))
  ! is_done "$name" || return 0
  line="polar: [$number/5] $title"
  printf '%s' "$line" >&2
  [[ -t 2 ]] || echo >&2
  mark "$name"
  set -m
  "$command" >>"$log" 2>&1 </dev/null &
  child=$!
  set +m
  while sleep 0.1 && kill -0 "$child" 2>/dev/null; do
    if [[ -t 2 ]]; then
      printf '\r\033[K%s ... %d s%s' "$line" $((SECONDS - start)) "$(progress "$name")" >&2
    elif ((SECONDS - start >= told + 15)); then
      told=$((SECONDS - start))
      printf '%s ... %d s%s\n' "$line" $told "$(progress "$name")" >&2
    fi
  done
  if ! wait "$child"; then
    child=
    printf '\n' >&2
    tail -n 25 -- "$log" >&2
    die "[$number/5] $title failed after $((SECONDS - start)) s; all of it stands in $log"
  fi
  child=
  [[ ! -t 2 ]] || printf '\r\033[K' >&2
  printf '%s: %d s\n' "$line" $((SECONDS - start)) >&2
  read_want
  mark "$name" "${want[$name]}"
}

set_up() {
  local lock
  [[ -w $root && (! -e $venv || -w $venv) ]] ||
    die "$venv has to be set up, and $(id -un) may not write there: its owner calls ./polar" \
      'once (with a Python that all may run), or make a clone of your own'
  exec {lock}<"$root" # children keep it open: a call waits for whatever a killed one left running
  if ! flock -n "$lock"; then
    say 'another call is setting up .venv: waiting for it'
    flock "$lock"
    read_want
    ! all_done || { exec {lock}<&-; return 0; }
  fi
  if [[ -e $venv && ! -e $stamp ]]; then
    die "$venv was not made by this script: move it away, then call again"
  fi
  # Half-unpacked requirements cannot be told from whole ones: start again from nothing.
  if [[ -e $stamp ]] && ! { is_done environment && have requirements; }; then
    say '.venv is from an interrupted set-up, another folder or another Python: making it anew'
    mark environment
  fi
  check_machine
  [[ -z $sourced ]] || say "the sourced ROS 2 $sourced is not used; .venv brings its own"
  trap stop INT TERM HUP
  mkdir -p "$venv" && touch "$stamp" && : >"$log"
  run_step environment "making .venv with $("$python" --version)" make_environment
  trap end_early EXIT
  is_done requirements || compile_early
  run_step requirements "installing $(grep -c == "$root/requirements.lock") packages" \
    install_requirements
  run_step messages 'building the messages' build_messages
  run_step packages 'linking our packages' link_packages
  run_step kernels 'compiling the numerical kernels' compile_kernels
  trap - INT TERM HUP EXIT
  exec {lock}<&-
}

write_lock() {
  local scratch
  find_python
  scratch=$(mktemp -d)
  # shellcheck disable=SC2064 # the name as it is now
  trap "rm -rf -- '$scratch'" EXIT
  "$python" -m venv "$scratch/venv"
  "$scratch/venv/bin/python" "$tools/development/environment.py" lock
}

leave_other_ros
if [[ ${1-} == lock ]]; then
  write_lock
  exit
fi
read_want
all_done || set_up
enter_environment
exec "$venv/bin/python" -P -m polar_nav_tools.cli "$@"
