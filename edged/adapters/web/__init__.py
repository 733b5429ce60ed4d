"""The status page: what the cell sees and does, for a browser next to it. Read-only, except for /api/v1."""

from edged.adapters.web.page import PageSources
from edged.adapters.web.server import SettingUp, WebPublisher
from edged.adapters.web.settings import WebSettings, page_context
