; At the door with a battery for one attempt and the way to the charger: it sticks in one of five attempts, and may be locked.
(define (problem household) (:domain household)
  (:objects
    robot - robot waste - item dining office trash - room table dumpster charger - furniture
    hall_dining_trash hall_dining_office hall_office_trash - hallway
    b0 b10 b20 b30 b40 b50 b60 b70 b80 b90 b100 - level)
  (:init
    (at robot hall_dining_trash) (in robot dining) (free robot) (on waste table) (battery robot b20) (charger charger) (full b100)
    (below b0 b10) (below b10 b20) (below b20 b30) (below b30 b40) (below b40 b50) (below b50 b60) (below b60 b70) (below b70 b80) (below b80 b90) (below b90 b100)
    (open hall_dining_office) (open hall_office_trash)
    (belongs_to table dining) (belongs_to charger dining) (belongs_to dumpster trash)
    (belongs_to hall_dining_trash dining) (belongs_to hall_dining_trash trash)
    (belongs_to hall_dining_office dining) (belongs_to hall_dining_office office)
    (belongs_to hall_office_trash office) (belongs_to hall_office_trash trash)
    (joins hall_dining_trash dining trash) (joins hall_dining_trash trash dining)
    (joins hall_dining_office dining office) (joins hall_dining_office office dining)
    (joins hall_office_trash office trash) (joins hall_office_trash trash office))
  (:goal (on waste dumpster)))
