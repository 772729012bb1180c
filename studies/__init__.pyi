from .machine import machine as machine
