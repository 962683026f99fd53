"""How Fast DDS is set in tests: over UDP within this machine, and with shorter leases where a test waits for them.

`ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` would add shared memory, whatever `FASTDDS_BUILTIN_TRANSPORTS` says (rmw_fastrtps 8.4). Its ports
are shared by all ROS domains, and lie behind processes that were killed: now and then one cannot be had, which Fast DDS says on the
standard output. So a profile names the transport, and ROS leaves it as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import distributions
from pathlib import Path
from typing import Final

from tests.support.files import written

_PROFILE: Final = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>udp</transport_id>
        <type>UDPv4</type>
        <maxInitialPeersRange>32</maxInitialPeersRange>
        {interfaces}
      </transport_descriptor>
    </transport_descriptors>
    <participant profile_name="tests" is_default_profile="true">
      <rtps>
        <useBuiltinTransports>false</useBuiltinTransports>
        <userTransports><transport_id>udp</transport_id></userTransports>
        <builtin>
          {peers}
          <discovery_config>{lease}</discovery_config>
        </builtin>
      </rtps>
    </participant>
  </profiles>
  <library_settings>
    <intraprocess_delivery>{within}</intraprocess_delivery>
  </library_settings>
</dds>
"""

_INTERFACES: Final = "<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>"
_PEERS: Final = "<initialPeersList><locator><udpv4><address>127.0.0.1</address></udpv4></locator></initialPeersList>"
LEASE: Final = 20
"""Seconds after which Fast DDS takes a process that is not heard for gone, by default."""
_PROFILES: Final = "FASTDDS_DEFAULT_PROFILES_FILE" if [*distributions(name="ros-fastdds")] else "FASTRTPS_DEFAULT_PROFILES_FILE"
"""The variable that names a profile: Fast DDS 3, which ROS 2 Kilted has, warns of the old one."""
_ANNOUNCEMENT: Final = "<leaseAnnouncement><sec>0</sec><nanosec>200000000</nanosec></leaseAnnouncement>"


def middleware(
    folder: Path, domain: int, *, lease: int | None = None, is_quick: bool = False, has_network: bool = False, within: bool = True
) -> Mapping[str, str]:
    """Return the environment of processes in a ROS domain.

    Args:
        folder: where the profile is written.
        domain: its number.
        lease: seconds after which a process that is not heard is taken for gone; `LEASE` by default.
        is_quick: have processes look out for each other every 0.2 s, and not every 3 s.
        has_network: they are on several hosts, and find each other by multicast.
        within: participants of one process may deliver directly to each other.
    """
    profile = _PROFILE.format(
        interfaces="" if has_network else _INTERFACES,
        peers="" if has_network else _PEERS,
        lease=(f"<leaseDuration><sec>{lease}</sec></leaseDuration>" if lease else "") + (_ANNOUNCEMENT if is_quick or lease else ""),
        within="FULL" if within else "OFF",
    )
    return {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET" if has_network else "SYSTEM_DEFAULT",
        _PROFILES: str(written(folder / "dds.xml", profile)),
    }
