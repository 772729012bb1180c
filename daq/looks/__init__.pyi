from .column import Look as Look
from .column import look as look
from .counter import unwrapped_counter as unwrapped_counter
