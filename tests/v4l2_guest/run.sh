#!/bin/bash
# run.sh [WORKDIR]: saint-live on a real kernel V4L2 node, without a camera.
#
# Boots Debian's stock kernel in QEMU (software emulation: some minutes) with a depth camera made of
# software (camera.rs) on the kernel's virtual USB controller, plays the scenarios of `init` (also
# with the kernel's test driver `vivid`), and checks what was recorded pixel by pixel and what was
# counted frame by frame (tests/v4l2_guest.rs).
#
# Needs Debian packages: qemu-system-x86 busybox-static cpio kmod; fetches the kernel's package.
# SAINT_LIVE=FILE uses a static binary built before instead of building one.
# Exits 0 when all holds, 1 when not, 77 when something it needs is missing.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
work=${1:-$root/target/v4l2_guest}
target=x86_64-unknown-linux-gnu
skip() { echo "v4l2_guest: skipped: $*"; exit 77; }

[ "$(uname -m)" = x86_64 ] || skip "the guest is x86_64"
for tool in qemu-system-x86_64 cpio modprobe depmod dpkg-deb apt-get; do
    PATH=$PATH:/usr/sbin:/sbin command -v "$tool" > /dev/null ||
        skip "$tool is missing (apt-get install --no-install-recommends qemu-system-x86 busybox-static cpio kmod)"
done
[ -x /bin/busybox ] || skip "/bin/busybox is missing (apt-get install busybox-static)"
export PATH=$PATH:/usr/sbin:/sbin
mkdir -p "$work"
cd "$work"

if [ ! -e kernel/ready ]; then
    package=$(apt-cache depends linux-image-amd64 | awk '/Depends: linux-image/ { print $2; exit }')
    [ -n "$package" ] || skip "apt knows no linux-image-amd64 (apt-get update)"
    apt-get download "$package" > /dev/null 2>&1 || skip "$package could not be downloaded"
    rm -rf kernel
    dpkg-deb --fsys-tarfile "$package"_*.deb | tar -x --one-top-level=kernel --wildcards \
        './boot/vmlinuz*' './lib/modules/*/modules.*' './lib/modules/*/kernel/fs/configfs/*' \
        './lib/modules/*/kernel/drivers/'{media,usb,input,virtio,block}'/*'
    rm -f "$package"_*.deb
    depmod -b kernel "$(ls kernel/lib/modules)" 2> /dev/null
    touch kernel/ready
fi
version=$(ls kernel/lib/modules)

binary=${SAINT_LIVE:-}
if [ -z "$binary" ]; then
    echo "v4l2_guest: building a static saint-live"
    RUSTFLAGS="-C target-feature=+crt-static" cargo build --quiet --release --bin saint-live \
        --manifest-path "$root/Cargo.toml" --target "$target" --target-dir "$work/target"
    binary=$work/target/$target/release/saint-live
fi
for program in camera control; do
    rustc --edition 2024 -O -C target-feature=+crt-static "$here/$program.rs" -o "$program"
done

# The initial file system: busybox, the modules in load order, our programs.
rm -rf tree
mkdir -p tree/{bin,dev,proc,sys,tmp,mod}
cp /bin/busybox tree/bin/
for applet in sh mount insmod sleep kill pidof mkdir tar sync poweroff sed head cat \
    chown chmod su; do
    ln -s busybox "tree/bin/$applet"
done
install -m 755 "$here/init" tree/init
install -m 755 "$binary" tree/bin/saint-live
install -m 755 camera control tree/bin/
modules() { # LIST MODULES...: what they need first, what an earlier list has left out
    list=$1; shift
    for module in "$@"; do
        modprobe -d "$PWD/kernel" -S "$version" --show-depends "$module"
    done | awk '$1 == "insmod" && !seen[$2]++ { print $2 }' | while read -r file; do
        [ ! -e "tree/mod/$(basename "$file")" ] || continue
        cp "$file" tree/mod/
        basename "$file" >> "tree/mod/$list"
    done
}
modules order virtio_pci virtio_blk uvcvideo vhci-hcd
modules order-vivid vivid
(cd tree && find . | cpio -o -H newc --quiet) > initrd.cpio

rm -rf out results.img
truncate -s 512M results.img
echo "v4l2_guest: booting $version"
timeout 2400 qemu-system-x86_64 -machine pc -cpu max -accel tcg -m 1024 -smp 1 \
    -kernel "kernel/boot/vmlinuz-$version" -initrd initrd.cpio \
    -drive file=results.img,format=raw,if=none,id=results -device virtio-blk-pci,drive=results \
    -nographic -no-reboot -nodefaults -serial stdio \
    -append "console=ttyS0 quiet panic=-1 no_timer_check" > guest.log 2>&1 || true
if ! grep -aq 'scenarios done' guest.log; then
    tail -n 40 guest.log
    echo "v4l2_guest: the guest did not finish (log: $work/guest.log)"
    exit 1
fi
tar -x -f results.img 2> /dev/null
rm -f results.img

for recording in out/*.mcap; do
    "$binary" export "$recording" -q --to png16 -o "${recording%.mcap}.frames"
done
SAINT_V4L2_GUEST=$work/out cargo test --quiet --manifest-path "$root/Cargo.toml" --test v4l2_guest
echo "v4l2_guest: passed"
