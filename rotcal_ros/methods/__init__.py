"""The calibration methods: a frozen problem in, a :class:`~rotcal_ros.results.Result` out."""
