"""What ``rotcal cell check`` looks at."""
