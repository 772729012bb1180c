"""Documents whose table of keys is made from their struct."""

from experiments.documents.comparison import ComparisonDocument
from experiments.documents.diagnosis import DiagnosisDocument
from experiments.documents.document import Document
from experiments.documents.fit import FitDocument
from experiments.documents.validation import ValidationDocument

DOCUMENTED: dict[str, type[Document]] = {"fit": FitDocument, "validation": ValidationDocument,
                                         "comparison": ComparisonDocument, "diagnosis": DiagnosisDocument}
"""By the name of the verb's result."""
