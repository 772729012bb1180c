from .preflight import checks_text as checks_text
from .preflight import default_rig as default_rig
from .preflight import examine as examine
from .preflight import listen as listen
