# ROS 2 Jazzy with this workspace built:
#   docker build -t vo2 .
#   docker run --rm -v "$PWD/output:/ws/output" vo2 demo
FROM ros:jazzy

RUN apt-get update \
 && apt-get install -y --no-install-recommends python3-venv python3-pip \
 && rm -rf /var/lib/apt/lists/*
WORKDIR /ws
COPY . .
# --help starts nothing; what comes before it makes the environment and builds
RUN bash -c "source /opt/ros/jazzy/setup.bash && ./vo2 run vo2_identification fit --help > /dev/null"
ENTRYPOINT ["/ros_entrypoint.sh", "./vo2"]
CMD ["demo"]
