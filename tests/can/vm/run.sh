#!/bin/sh
# Boots a Debian kernel in qemu with the vcan module and runs socketcan_check in it.
#   tests/can/vm/run.sh PROGRAM [FOLDER]     FOLDER: where Debian's linux-image package was unpacked, default /
# Needs: qemu-system-x86, busybox-static, cpio, and a kernel with modules:
#   apt-get download linux-image-amd64's dependency; dpkg-deb -x linux-image-*.deb FOLDER
# PROGRAM is built with -static (target godwit_socketcan_check).
set -eu
program=$1
root=${2:-}
kernel=$(ls "$root"/boot/vmlinuz-* 2>/dev/null | sort -V | tail -1)
for need in qemu-system-x86_64 cpio; do
  command -v $need >/dev/null || { echo "SKIPPED: $need is not installed"; [ "${CI:-}" = "true" ] && exit 1; exit 77; }
done
if [ -z "$kernel" ] || [ ! -x /bin/busybox ]; then echo "SKIPPED: no kernel in $root/boot, or no busybox-static"; [ "${CI:-}" = "true" ] && exit 1; exit 77; fi
modules="$root/lib/modules/$(basename "$kernel" | sed 's/^vmlinuz-//')/kernel"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir -p "$work/fs/bin" "$work/fs/proc" "$work/fs/sys" "$work/fs/dev"
cp /bin/busybox "$work/fs/bin/busybox"
cp "$program" "$work/fs/check"
for module in net/can/can net/can/can-raw drivers/net/can/dev/can-dev drivers/net/can/vcan; do
  find "$modules" -path "*/$module.ko*" -exec cp {} "$work/fs/" \;
done
# busybox' own ip cannot make a vcan: iproute2's, with its libraries.
cp "$(command -v ip)" "$work/fs/bin/ip"
ldd "$(command -v ip)" | grep -o '/[^ ]*' | while read -r library; do
  mkdir -p "$work/fs$(dirname "$library")"
  cp "$library" "$work/fs$library"
done
cat >"$work/fs/init" <<'INIT'
#!/bin/busybox sh
/bin/busybox --install -s /bin 2>/dev/null
export PATH=/bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
for m in can can-raw can-dev vcan; do insmod /$m.ko; done
ip=/bin/ip  # by its path: busybox prefers its own, which knows no vcan
$ip link set lo up
$ip link add dev vcan0 type vcan && $ip link set vcan0 mtu 72 && $ip link set vcan0 up
/check
poweroff -f
INIT
chmod +x "$work/fs/init"
(cd "$work/fs" && find . | cpio -o -H newc --quiet | gzip -1) >"$work/initramfs"
timeout 240 qemu-system-x86_64 -M pc -accel tcg -cpu max -m 256 -nographic -no-reboot -kernel "$kernel" -initrd "$work/initramfs" \
  -append "console=ttyS0 no_timer_check quiet panic=-1" >"$work/log" 2>&1 || true
grep -aE '^(ok|FAIL|SOCKETCAN)|panic|insmod' "$work/log" | tr -d '\r'
grep -aq 'SOCKETCAN PASSED' "$work/log" || { tail -20 "$work/log"; exit 1; }
