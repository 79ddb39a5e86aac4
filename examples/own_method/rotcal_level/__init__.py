"""Electronic levels on the table: a method for rotcal_ros that lives in its own package."""
