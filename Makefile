# Two commands are all a fresh Debian 12 or Ubuntu machine needs: `make demo` runs the main job, `make test` the tests.
# Both first run scripts/setup.sh, which installs what is missing and says so.

# A toolchain that setup.sh has just installed is not on the PATH of this shell yet.
export PATH := $(HOME)/.cargo/bin:$(PATH)
OUT ?= demo

.PHONY: demo test build setup help

help:
	@echo "make demo    synthesise a site, train on it, write DSM, pictures and errors to $(OUT)/"
	@echo "make test    run all tests"
	@echo "make build   build target/release/heliosplat"
	@echo "make setup   install system packages and Rust where they are missing"

demo: build
	target/release/heliosplat demo --out $(OUT)

test: setup
	cargo test --locked --workspace --exclude heliosplat-python

build: setup
	cargo build --release --locked --package heliosplat

setup:
	@scripts/setup.sh
