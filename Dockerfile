# rotcal_ros with ROS 2 from wheels, for x86-64. Build and run: docs/install.md
# The most exact tag; --build-arg BASE=...@sha256:... pins its bytes, too.
ARG BASE=docker.io/library/debian:bookworm-20260202-slim

FROM ${BASE} AS build
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
        ca-certificates g++ make python3 python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/rotcal
COPY . .
# The same set-up as `make`, without what only tests need.
RUN ROTCAL_EXTRAS=ros,parquet,page,packages scripts/setup.sh && rm -rf build

FROM ${BASE}
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home --uid 1000 rotcal
COPY --from=build /opt/rotcal /opt/rotcal
# HOME: any user may run it, also one that has no entry in /etc/passwd.
ENV PATH=/opt/rotcal/.venv/bin:$PATH HOME=/tmp
USER rotcal
WORKDIR /work
ENTRYPOINT ["rotcal"]
CMD ["--help"]
