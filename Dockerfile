# The program in a container of Debian's packages alone:
#   docker build --tag relight .
#   docker run --rm --user "$(id -u):$(id -g)" --volume "$PWD:/work" relight run demo --out out
FROM debian:trixie-slim AS build
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends ca-certificates gcc libc6-dev rustup \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
RUN cargo build --locked --profile dist --package relight

FROM debian:trixie-slim
COPY --from=build /source/target/dist/relight /usr/local/bin/relight
# The program unpacks its graphs and networks, and keeps its cache, in the home of whoever runs it.
ENV HOME=/tmp/home
RUN mkdir --mode=1777 /tmp/home
WORKDIR /work
ENTRYPOINT ["relight"]
CMD ["--help"]
