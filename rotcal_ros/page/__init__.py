"""Pages in a browser, without ROS: what is shown, and how a browser is kept up to date."""
