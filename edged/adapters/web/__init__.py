"""The status page: what the cell sees and does, for a browser beside it. Read-only."""

from edged.adapters.web.page import Sources
from edged.adapters.web.server import WebPublisher, WebSettings, page_context

__all__ = ["Sources", "WebPublisher", "WebSettings", "page_context"]
