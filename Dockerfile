# An image that contains only the program and the C library:
#
#     docker build -t wavex .
#     docker run --rm -v "$PWD:/data" -w /data wavex run job.toml
#
# Without a network: first `cargo vendor --locked vendor` in this folder.
FROM rust:1.95-slim-bookworm AS build
WORKDIR /wavex
COPY . .
RUN if [ -d vendor ]; then \
        cargo build --release --locked --offline --bin wavex \
            --config 'source.crates-io.replace-with="vendor"' --config 'source.vendor.directory="vendor"'; \
    else cargo build --release --locked --bin wavex; fi

FROM debian:bookworm-slim
COPY --from=build /wavex/target/release/wavex /usr/bin/wavex
ENTRYPOINT ["wavex"]
