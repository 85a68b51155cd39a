#!/bin/sh
# Runs inside an empty Debian, as root: install, fly, start the daemon, upgrade, roll back, remove, purge.
#   in_root.sh FOLDER INSTALL..   FOLDER holds old/, new/ (packages of two versions); INSTALL is what installs files
set -eu
folder=$1
shift
say() { echo "in_root: $*"; }
fail() { echo "in_root: FAILED: $*"; exit 1; }
version() { dpkg-query -W -f '${Version}' godwit; }
config=/etc/godwit/godwit.toml
# Nothing here asks ls: in the arm64 root it calls statx, whose paths proot 5.1 does not lead into the root.
old=$(dpkg-deb -f "$folder"/old/godwit_*.deb Version)
new=$(dpkg-deb -f "$folder"/new/godwit_*.deb Version)
command -v cc g++ gcc && fail "there is a compiler: this is no clean machine"

"$@" "$folder"/old/*.deb
[ "$(version)" = "$old" ] || fail "version $(version), expected $old"
say "installed $old on $(uname -m): $(godwit --version)"

cd /tmp
godwit fly street --frames 2 --detector on --out /tmp/flown >/tmp/fly.log 2>&1 || { cat /tmp/fly.log; fail "godwit fly"; }
[ -s /tmp/flown/summary.json ] || fail "godwit fly wrote no summary.json"
say "godwit fly street, with the network: summary.json is there"

# Boards are looked for, by a library that not every OpenCV has; in these pictures there is none.
godwit sim street --frames 2 --out /tmp/seen >/tmp/sim.log 2>&1 || { cat /tmp/sim.log; fail "godwit sim"; }
if godwit calibrate camera /tmp/seen --board aprilgrid:6x6:0.088:0.3 >/tmp/calibrate.log 2>&1; then fail "a camera calibrated by no board"; fi
grep -q 'the board was found in 0 pictures' /tmp/calibrate.log || { cat /tmp/calibrate.log; fail "godwit calibrate camera"; }
say "godwit calibrate camera looks for boards"

# The tools, where their package is among those installed; that dpkg has a line for it says no more than that another names it.
if [ "$(dpkg-query -W -f '${db:Status-Status}' godwit-tools 2>/dev/null)" = installed ]; then
  for tool in report evaluate from-video from-kitti; do
    godwit-$tool --help >/tmp/tool.log 2>&1 || { cat /tmp/tool.log; fail "godwit-$tool"; }
  done
  say "godwit-report, -evaluate, -from-video and -from-kitti tell what they do"
fi

# The daemon in the foreground: it flies the simulated camera until it is told to end.
printf '[camera]\nsource = "sim"\nscenario = "street"\npictures = 2\n[detector]\nenabled = false\n' >/tmp/sim.toml
godwitd --config /tmp/sim.toml >/tmp/daemon.log 2>&1 &
pid=$!
tries=0
while ! grep -q armed /tmp/daemon.log && [ $tries -lt 240 ]; do sleep 1; tries=$((tries + 1)); done
grep -q armed /tmp/daemon.log || { cat /tmp/daemon.log; fail "godwitd does not fly"; }
sleep 5
kill -0 $pid 2>/dev/null || { cat /tmp/daemon.log; fail "godwitd did not stay"; }
kill -TERM $pid
code=0
wait $pid || code=$?
[ $code = 0 ] || [ $code = 130 ] || { cat /tmp/daemon.log; fail "godwitd ended with $code"; }
say "godwitd flew and ended on SIGTERM: $(tail -n 1 /tmp/daemon.log)"

echo '# changed by hand' >>$config
"$@" "$folder"/new/*.deb
[ "$(version)" = "$new" ] || fail "upgrade: version $(version), expected $new"
grep -q 'changed by hand' $config || fail "the upgrade has overwritten $config"
say "upgraded to $new, $config kept"

"$@" "$folder"/old/*.deb
[ "$(version)" = "$old" ] || fail "roll back: version $(version), expected $old"
grep -q 'changed by hand' $config || fail "the roll back has overwritten $config"
say "rolled back to $old, $config kept"

state=/var/lib/godwit
mkdir -p $state/flights $state/events/000001
touch $state/lock $state/link_parameters.txt $state/link_reset_counter.txt $state/flights/000001.ulg $state/events/000001/imu.csv
dpkg --remove godwit >/dev/null
[ ! -e /usr/bin/godwitd ] && [ -e $config ] && [ -e $state/link_parameters.txt ] || fail "removed: programs must go, $config and state stay"
say "removed"
dpkg --purge $(dpkg-query -W -f '${Package} ' godwit 'godwit-*') >/dev/null
for path in flights/000001.ulg events/000001/imu.csv; do
  [ -e $state/$path ] || fail "purged, and with it what is the operator's: $state/$path"
done
left=
for path in $config $state/lock $state/link_parameters.txt $state/link_reset_counter.txt /usr/share/godwit /usr/share/doc/godwit; do
  [ ! -e "$path" ] || left="$left $path"
done
[ -z "$left" ] || fail "purged, and something is left: $left"
say "purged; nothing is left but flights and events"
