from .demo_rig import started_demo_rig as started_demo_rig
from .server import serve as serve
