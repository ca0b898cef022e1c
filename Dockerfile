# koop on the official Jazzy image: docker build -t koop . && docker run --rm -it --shm-size=1g koop
FROM ros:jazzy AS tools
RUN apt-get update \
    && apt-get install -y --no-install-recommends curl git python3-venv \
    && rm -rf /var/lib/apt/lists/*

FROM tools
COPY . /koop
WORKDIR /koop
RUN . /opt/ros/jazzy/setup.sh && ./koop setup
CMD ["./koop", "demo"]
