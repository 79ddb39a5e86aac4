"""The verbs below ``rotcal plan`` that design and trade."""
