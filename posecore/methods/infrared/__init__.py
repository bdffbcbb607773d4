"""From infrared images to point clouds: a cloud estimator that learns from masks in other views."""
