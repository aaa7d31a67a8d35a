"""Format ``exumi-session``: raw sessions as exUMI's hub and its GoPro leave them."""

from exumi_converters.exumi_session.converter import ExumiSessionConverter
from exumi_converters.exumi_session.options import SessionOptions

__all__ = ["ExumiSessionConverter", "SessionOptions"]
