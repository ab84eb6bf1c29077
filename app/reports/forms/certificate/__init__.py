"""A report as a Digital Calibration Certificate (DCC 3.2.0 of the Physikalisch-Technische Bundesanstalt).

The quantities are the report's, in the Digital System of Units; its sections of words stand as text. What the schema
asks for and nobody stated is written as not stated.
"""

from app.reports.forms.certificate.document import certificate_xml

__all__ = ["certificate_xml"]
