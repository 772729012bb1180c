from .casebook import casebook_document as casebook_document
from .casebook import cases_in as cases_in
from .casebook import load_cases as load_cases
from .casebook import study_case as study_case
from .casebook_page import study_text as study_text
from .casebook_page import write_casebook as write_casebook
from .machine import machine as machine
from .walker import motor_mechanism as motor_mechanism
