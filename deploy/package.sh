#!/usr/bin/env bash
# Makes packages of the program: deploy/package.sh tarball|deb|image|wheel|all [PROGRAM]
#
# Without PROGRAM, a release build of this clone is packed. Packages are written to target/packages, and each is tried
# before it is done: unpacked somewhere else, and started from / with nothing but itself in PATH.
#
#   tarball   metamorph-VERSION-ARCH.tar.gz: program with links between machines, man pages, completions, licences of all parts,
#             the service of a host's daemon, and examples for clusters
#   deb       metamorph_VERSION_ARCH.deb, by dpkg-deb
#   image     metamorph-VERSION-ARCH.oci.tar, by mmdebstrap and buildah; no engine, and nothing is pulled
#   wheel     the Python package with the program in it, by pip
#
# The same sources, SOURCE_DATE_EPOCH and tools give the same tarball and the same .deb.
set -euo pipefail
cd "$(dirname "$0")/.."

kind=${1:-}
case "$kind" in
tarball | deb | image | wheel | all) ;;
*)
    sed -n '2,13s/^# \{0,1\}//p' "$0" >&2
    exit 2
    ;;
esac

need() {
    command -v "$1" >/dev/null || {
        echo "package.sh: $1 is not installed
  fix: apt install $2" >&2
        exit 1
    }
}

version=$(sed -n '/^\[workspace.package\]/,/^$/s/^version = "\(.*\)"/\1/p' Cargo.toml)
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 0)}
export SOURCE_DATE_EPOCH
out=$PWD/target/packages
mkdir -p "$out"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

program=${2:-}
if [ -z "$program" ] && [ "$kind" != wheel ]; then
    need cargo cargo
    cargo build --release --locked --package metamorph-world-controller --features hosts --bin metamorph
    program=target/release/metamorph
fi
arch=$(uname -m)
name=metamorph-$version-$arch

# Lays out the files of a package below a directory, as in /usr.
lay_out() {
    local usr=$1
    install -D -m 755 "$program" "$usr/bin/metamorph"
    strip "$usr/bin/metamorph"
    "$usr/bin/metamorph" man "$usr/share/man/man1" >/dev/null
    gzip -9 -n "$usr"/share/man/man1/*
    install -d "$usr/share/bash-completion/completions" "$usr/share/zsh/vendor-completions" "$usr/share/fish/vendor_completions.d"
    "$usr/bin/metamorph" completions bash >"$usr/share/bash-completion/completions/metamorph"
    "$usr/bin/metamorph" completions zsh >"$usr/share/zsh/vendor-completions/_metamorph"
    "$usr/bin/metamorph" completions fish >"$usr/share/fish/vendor_completions.d/metamorph.fish"
    install -d "$usr/share/doc/metamorph"
    install -m 644 LICENSE-MIT LICENSE-APACHE world-controller/cli/third-party.txt "$usr/share/doc/metamorph"
    gzip -9 -n <CHANGELOG.md >"$usr/share/doc/metamorph/NEWS.gz"
    install -d "$usr/lib/systemd/user" "$usr/share/doc/metamorph/examples"
    sed 's,/usr/local/bin/,/usr/bin/,' deploy/hosts/metamorph-host.service >"$usr/lib/systemd/user/metamorph-host.service"
    install -m 644 deploy/hosts/*.toml deploy/hosts/*.yaml deploy/cluster/* "$usr/share/doc/metamorph/examples"
    chmod -R go=rX "$usr"
    find "$usr" -type f ! -path '*/bin/*' -exec chmod 644 {} +
}

# Tries an unpacked program: simulated, and as processes, which are the program itself. The directory is / and PATH
# names nothing, so that nothing of this clone is found.
try() {
    local binary=$1
    (
        cd /
        PATH=/nonexistent "$binary" --version
        PATH=/nonexistent "$binary" run swarm --link sim --quiet
        PATH=/nonexistent "$binary" run swarm --quiet
        # Links between machines are in it.
        PATH=/nonexistent "$binary" cluster --help >/dev/null
    )
}

tarball() {
    lay_out "$work/tar/$name"
    tar --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" -C "$work/tar" -cf - "$name" |
        gzip -9 -n >"$out/$name.tar.gz"
    mkdir "$work/untar"
    tar -xzf "$out/$name.tar.gz" -C "$work/untar"
    try "$work/untar/$name/bin/metamorph"
    echo "$out/$name.tar.gz"
}

deb() {
    need dpkg-deb dpkg
    need objdump binutils
    local root=$work/deb file
    file=$out/metamorph_${version}_$(dpkg --print-architecture).deb
    # The variables are those of Debian's tools.
    local maintainer="${DEBFULLNAME:-Metamorph} <${DEBEMAIL:-metamorph@localhost}>" glibc
    lay_out "$root/usr"
    "$program" licences >"$root/usr/share/doc/metamorph/copyright"
    printf 'metamorph (%s) unstable; urgency=medium\n\n  * See NEWS.gz.\n\n -- %s  %s\n' \
        "$version" "$maintainer" "$(date -R -u --date="@$SOURCE_DATE_EPOCH")" |
        gzip -9 -n >"$root/usr/share/doc/metamorph/changelog.gz"
    # The newest symbols that the program needs say which library it needs.
    glibc=$(objdump -T "$root/usr/bin/metamorph" | grep -o 'GLIBC_[0-9.]*' | sort -uV | tail -1)
    install -d "$root/DEBIAN"
    cat >"$root/DEBIAN/control" <<EOF
Package: metamorph
Version: $version
Architecture: $(dpkg --print-architecture)
Maintainer: $maintainer
Installed-Size: $(du -sk "$root/usr" | cut -f1)
Depends: libc6 (>= ${glibc#GLIBC_}), libgcc-s1
Section: science
Priority: optional
Description: runs swarms of self-reconfigurable modular robots
 Every module is a process of its own and talks to its neighbours only; the
 same modules also run simulated in virtual time, the same for one seed.
EOF
    find "$root" -exec touch --no-dereference --date="@$SOURCE_DATE_EPOCH" {} +
    dpkg-deb --root-owner-group -b "$root" "$file" >/dev/null
    mkdir "$work/undeb"
    dpkg-deb -x "$file" "$work/undeb"
    try "$work/undeb/usr/bin/metamorph"
    echo "$file"
}

image() {
    need mmdebstrap mmdebstrap
    need buildah buildah
    local root=$work/root container file=$out/$name.oci.tar
    mmdebstrap --quiet --variant=minbase --include=libgcc-s1 "$(. /etc/os-release && echo "$VERSION_CODENAME")" "$root"
    # What is only there to install more.
    rm -rf "$root"/var/lib/apt/lists/* "$root"/var/cache/apt/*
    lay_out "$work/tree/usr"
    container=$(buildah from scratch)
    buildah add --quiet "$container" "$root" / >/dev/null
    buildah add --quiet "$container" "$work/tree" / >/dev/null
    buildah config --entrypoint '["metamorph"]' --cmd --help --workingdir /work "$container"
    buildah run --isolation chroot "$container" -- metamorph run swarm --link sim --quiet
    buildah commit --quiet --rm --disable-compression=false --timestamp "$SOURCE_DATE_EPOCH" "$container" "oci-archive:$file:metamorph:$version" >/dev/null
    echo "$file; start it with --shm-size: metamorph doctor --modules N says how much a swarm needs"
}

wheel() {
    need python3 python3
    python3 -m venv "$work/venv"
    "$work/venv/bin/pip" wheel --quiet --no-deps --wheel-dir "$out" ./deploy/python
    "$work/venv/bin/pip" install --quiet "$out"/metamorph_swarm-"$version"-*.whl
    try "$work/venv/bin/metamorph"
    ls "$out"/*.whl
}

if [ "$kind" = all ]; then
    for kind in tarball deb image wheel; do "$kind"; done
else
    "$kind"
fi
