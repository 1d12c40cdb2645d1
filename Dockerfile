# The command `manifold` with Mitsuba's fast variants:
#   docker build -t manifold . && docker run --rm -v "$PWD:/data" manifold demo
FROM python:3.13-slim-trixie
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends libllvm19 && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends g++ \
    && pip install --no-cache-dir "/source[all]" && rm -r /source \
    && apt-get purge -y -qq --auto-remove g++ && rm -rf /var/lib/apt/lists/*
WORKDIR /data
ENTRYPOINT ["manifold"]
