"""Programs that check a cell or a computer: ``rotcal cell check`` and ``rotcal doctor``."""
