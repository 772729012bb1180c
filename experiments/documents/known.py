"""Documents whose table of keys is made from their struct."""

from experiments.documents.change import ChangeDocument, SessionsDocument
from experiments.documents.comparison import ComparisonDocument
from experiments.documents.diagnosis import DiagnosisDocument
from experiments.documents.document import Document
from experiments.documents.fit import FitDocument
from experiments.documents.tuning import TuningDocument
from experiments.documents.validation import ValidationDocument

DOCUMENTED: dict[str, type[Document]] = {
    "fit": FitDocument, "diagnosis": DiagnosisDocument, "validation": ValidationDocument,
    "comparison": ComparisonDocument, "change": ChangeDocument, "sessions": SessionsDocument,
    "tuning": TuningDocument}
"""By the name of the verb's result."""
