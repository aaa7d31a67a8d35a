"""From a rig file to its devices, as they are recorded."""

from exumi_recorders.contract import Port
from exumi_recorders.recording.device import RecordedDevice
from exumi_recorders.rig.model import Rig

__all__ = ["recorded_devices", "recorded_ports"]


def recorded_devices(rig: Rig) -> list[RecordedDevice]:
    """Return a rig's devices, which are not open yet.

    Parameters
    ----------
    rig : Rig
    """
    return [
        RecordedDevice(device.name, device.driver.make(device.options), device.streams)
        for device in rig.devices
    ]


def recorded_ports(devices: list[RecordedDevice]) -> dict[str, Port]:
    """Return the ports of devices by the names of their streams, as known before they are open.

    Parameters
    ----------
    devices : list of RecordedDevice
    """
    return {
        device.streams[port.name]: port
        for device in devices
        for port in device.driver.ports
        if port.name in device.streams
    }
