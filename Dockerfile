# The car's program in a container, and its tests. How to use it: docs/how-to/run-in-a-container.md
FROM python:3.12-slim-bookworm AS built
ENV LANG=C.UTF-8 PIP_NO_CACHE_DIR=1
RUN apt-get -qq update && \
    apt-get -qq install -y --no-install-recommends git make && \
    rm -rf /var/lib/apt/lists/*
WORKDIR /steerd
COPY . .
RUN make install
ENV PATH=/steerd/.venv/bin:$PATH

# docker build --target test: what CI does, when it is run
FROM built AS test
CMD ["bash", ".ci/run"]

FROM built AS car
STOPSIGNAL SIGTERM
ENTRYPOINT ["steerd"]
CMD ["--help"]
