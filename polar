#!/usr/bin/env bash
# The one door to polar_nav. On first use it makes .venv beside this file and installs everything
# into it; after that it only compares a stamp and runs the command line tool. Numerical kernels are
# compiled in the background, beside the set-up and the first commands.
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
compiling=$venv/.polar_compiling # locked while something is compiled; process group and key of that
compiling_log=$venv/kernels.log
early=$venv/early # marks of what is in place before its step is done
tools=$root/polar_nav_tools/polar_nav_tools
PATH=${PATH//"$venv/bin:"/} # an activated .venv is not the Python that makes .venv

say() { printf 'polar: %s\n' "$*" >&2; }
die() { say "$@"; exit 1; }
# Say it from within a step, whose output goes to the log.
tell() { say "$@"; [[ ! -t 3 ]] || printf '\r\033[K' >&3; say "$@" 2>&3; }

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
ready() {
  is_done environment && is_done requirements && is_done messages && is_done packages
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

# Pins of the lock file with their hashes: of some, or of all but uv itself.
chosen() {
  local name
  (($# > 0)) || sed '/^uv==/,/[^\\]$/d' "$root/requirements.lock"
  for name in "$@"; do sed -n "/^$name==/,/[^\\\\]\$/p" "$root/requirements.lock"; done
}

# One source archive is among the requirements (empy); --no-build-isolation builds it with the pinned
# setuptools instead of the newest. What is imported is compiled then, all else in the background.
pip_install() {
  local pip=("$venv/bin/python" -m pip install --no-deps --no-input --progress-bar off)
  pip+=(--only-binary ':all:' --no-binary empy --no-build-isolation --use-pep517)
  pip+=(--no-compile --require-hashes)
  "${pip[@]}" -r <(chosen "$@")
}

# uv takes files and unpacks them side by side, pip one after the other.
install() {
  if [[ -e $early/uv ]]; then
    "$venv/bin/python" "$tools/development/environment.py" install -r <(chosen "$@") && return
    rm -f -- "$early/uv"
    tell 'uv has not installed it (setup.log); pip tries, which takes longer'
  fi
  pip_install "$@"
}

# What kernels are compiled with comes first, then what builds the messages: both wait for it.
install_requirements() {
  if pip_install uv; then
    : >"$early/uv"
  else
    tell 'uv is not to be had here; pip installs, which takes longer'
  fi
  install numba llvmlite numpy scipy gsw pygeomag pyyaml setuptools
  : >"$early/compiler"
  install 'ros-[a-z0-9-]*' scikit-build-core cmake ninja packaging pathspec empy lark-parser \
    catkin-pkg pyparsing docutils python-dateutil tzdata
  : >"$early/generators"
  install
}

make_wheels() {
  local pip=("$venv/bin/python" -m pip wheel --no-deps --no-build-isolation --no-input) other
  pip+=(--wheel-dir "$early/wheels")
  export PATH=$venv/bin:$PATH
  rm -rf -- "$early/wheels" && mkdir -p "$early/wheels"
  "${pip[@]}" "$root/polar_nav_msgs/tf2_msgs" &
  other=$!
  "${pip[@]}" "$root/polar_nav_msgs" || { wait "$other" || true; return 1; }
  wait "$other"
}

# Build the messages beside the packages. The step for messages waits for it, and does it all where
# this failed.
beside=
build_early() {
  set -m
  {
    await generators
    make_wheels
    : >"$early/messages"
  } >>"$log" 2>&1 </dev/null &
  beside=$!
  set +m
}

# Wait for a mark, as long as the set-up goes on.
await() {
  until [[ -e $early/$1 ]]; do
    kill -0 $$ 2>/dev/null || exit 1
    sleep 0.2
  done
}

build_messages() {
  while [[ -n $beside ]] && kill -0 "$beside" 2>/dev/null; do sleep 0.1; done
  [[ -e $early/messages ]] || make_wheels
  rm -f -- "$early/messages"
  "$venv/bin/python" -m pip install --no-deps --no-input --no-index --force-reinstall \
    "$early/wheels/"*.whl
  rm -rf -- "$early/wheels"
}

link_packages() { "$venv/bin/python" "$tools/development/environment.py" link; }

# Compile kernels in the background, in a process group of its own that outlives this call, unless
# another call does already. What needs a kernel meanwhile waits for it (polar_nav_core.background).
lock=
compile_in_background() {
  local held made_for
  [[ -w $venv ]] || return 0 # of another user: nodes compile into a folder of their own
  exec {held}>>"$compiling"
  if ! flock -n "$held"; then
    for _ in 1 2; do # the second time, what has just begun has said what it compiles
      read -r _ made_for _ <"$compiling" || true
      if [[ $made_for == "${want[kernels]}" ]]; then
        exec {held}>&-
        return
      fi
      sleep 0.2
    done
    end_background
    flock "$held"
  fi
  echo "- ${want[kernels]}" >"$compiling"
  say "the numerical kernels are compiled in the background; what needs one waits for it"
  mkdir -p "$early"
  ! is_done requirements || : >"$early/compiler"
  # From a subshell, so that it is no child of the command that takes the place of this script.
  (
    set -m
    compile_kernels "${want[kernels]}" >"$compiling_log" 2>&1 </dev/null &
    echo "$! ${want[kernels]}" >"$compiling"
  )
  exec {held}>&-
}

compile_kernels() { # key; the lock on $compiling is inherited, and held as long as any of this runs
  local own
  trap '' HUP
  [[ -z $lock ]] || exec {lock}<&-
  await compiler
  export POLAR_NAV_COMPILES=1 PYTHONPATH=$root/polar_nav_core
  # Behind what somebody looks at, but not for ever on a machine that others load: commands wait.
  nice -n 5 "$venv/bin/python" -P -m polar_nav_core.warm
  exec {own}<"$root" # whoever sets up writes the same file
  flock "$own"
  mark kernels "$1"
  exec {own}<&-
  echo "$BASHPID $1 kernels" >"$compiling" # are there: commands go on
  # Users who may not write here would compile what they import at every start: all but tests. Some
  # packages hold files of other Pythons, which do not compile.
  nice -n 5 "$venv/bin/python" -m compileall -qq -x 'site-packages/.*/tests?/' \
    "$venv"/lib/python3*/site-packages || true
}

end_background() {
  local held group=
  [[ -e $compiling ]] || return 0
  exec {held}<"$compiling"
  if ! flock -n "$held"; then
    read -r group _ <"$compiling" || true
    [[ $group != [1-9]* ]] || kill -TERM -- "-$group" 2>/dev/null || true
    flock "$held"
  fi
  exec {held}<&-
}

end_early() {
  if [[ -n $beside ]]; then
    kill -TERM -- "-$beside" 2>/dev/null || true
    wait "$beside" 2>/dev/null || true
    beside=
  fi
  end_background
}

# How far the packages are: with pip first all are looked up, then unpacked.
progress() {
  local total looked_up unpacked
  [[ $1 == requirements ]] || return 0
  total=$(grep -c "==" "$root/requirements.lock")
  if [[ ! -e $early/uv ]] &&
    [[ $(grep '^Collecting\|^Installing collected packages: .*,' "$log" | tail -n 1) == C* ]]; then
    looked_up=$(grep '^Collecting' "$log" | sort -u | wc -l)
    echo ", $looked_up of $total fetched"
  else
    unpacked=$(find "$venv"/lib/python3*/site-packages -maxdepth 1 -name '*.dist-info' ! -name 'pip-*' | wc -l)
    echo ", $unpacked of $total unpacked"
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
  line="polar: [$number/4] $title"
  printf '%s' "$line" >&2
  [[ -t 2 ]] || echo >&2
  mark "$name"
  set -m
  "$command" 3>&2 >>"$log" 2>&1 </dev/null &
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
    die "[$number/4] $title failed after $((SECONDS - start)) s; all of it stands in $log"
  fi
  child=
  [[ ! -t 2 ]] || printf '\r\033[K' >&2
  printf '%s: %d s\n' "$line" $((SECONDS - start)) >&2
  [[ $name != environment ]] || read_want # the Python of .venv is in it
  mark "$name" "${want[$name]}"
}

set_up() {
  [[ -w $root && (! -e $venv || -w $venv) ]] ||
    die "$venv has to be set up, and $(id -un) may not write there: its owner calls ./polar" \
      'once (with a Python that all may run), or make a clone of your own'
  exec {lock}<"$root" # children keep it open: a call waits for whatever a killed one left running
  if ! flock -n "$lock"; then
    say 'another call is setting up .venv: waiting for it'
    flock "$lock"
    read_want
    ! ready || { exec {lock}<&-; lock=; return 0; }
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
  rm -f -- "$early/messages" # of sources as they were
  if ! is_done environment || ! is_done requirements; then end_background; fi
  run_step environment "making .venv with $("$python" --version)" make_environment
  trap end_early EXIT
  if ! is_done requirements; then
    rm -rf -- "$early" && mkdir "$early"
    build_early
    compile_in_background
  fi
  run_step requirements "installing $(grep -c == "$root/requirements.lock") packages" \
    install_requirements
  run_step messages 'building the messages' build_messages
  run_step packages 'linking our packages' link_packages
  trap - INT TERM HUP EXIT
  exec {lock}<&-
  lock=
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
ready || set_up
is_done kernels || compile_in_background
enter_environment
exec "$venv/bin/python" -P -m polar_nav_tools.cli "$@"
