"""Recording episodes from hardware: device drivers, journal, session and calibration."""

__all__: list[str] = []
