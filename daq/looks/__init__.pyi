from .column import Look as Look
from .column import look as look
