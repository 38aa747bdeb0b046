"""Planning of motions: straight lines and strikes, transfers between configurations, views; their timing."""
