; Both, on a battery that does not last: the charger is behind doors that are shut.

(define (problem household-4)
  (:domain household)

  (:objects
    robot - robot
    dining kitchen trash closet office - room
    hall_dining_office hall_closet_dining hall_dining_trash hall_dining_kitchen
    hall_kitchen_trash hall_kitchen_office hall_closet_trash hall_closet_office - hallway
    table desk fridge pantry bin dumpster charger - furniture
    bread0 snacks0 soda0 butter0 waste0 waste1 - item)

  (:init
    (at robot dining) (came_from robot dining) (free robot)

    (belongs_to dining dining) (belongs_to kitchen kitchen) (belongs_to trash trash) (belongs_to closet closet) (belongs_to office office)
    (belongs_to table dining) (belongs_to desk office) (belongs_to fridge kitchen) (belongs_to pantry kitchen)
    (belongs_to bin office) (belongs_to dumpster trash) (belongs_to charger closet)
    (joins hall_dining_office dining office) (joins hall_dining_office office dining)
    (belongs_to hall_dining_office dining) (belongs_to hall_dining_office office)
    (joins hall_closet_dining closet dining) (joins hall_closet_dining dining closet)
    (belongs_to hall_closet_dining closet) (belongs_to hall_closet_dining dining)
    (joins hall_dining_trash dining trash) (joins hall_dining_trash trash dining)
    (belongs_to hall_dining_trash dining) (belongs_to hall_dining_trash trash)
    (joins hall_dining_kitchen dining kitchen) (joins hall_dining_kitchen kitchen dining)
    (belongs_to hall_dining_kitchen dining) (belongs_to hall_dining_kitchen kitchen)
    (joins hall_kitchen_trash kitchen trash) (joins hall_kitchen_trash trash kitchen)
    (belongs_to hall_kitchen_trash kitchen) (belongs_to hall_kitchen_trash trash)
    (joins hall_kitchen_office kitchen office) (joins hall_kitchen_office office kitchen)
    (belongs_to hall_kitchen_office kitchen) (belongs_to hall_kitchen_office office)
    (joins hall_closet_trash closet trash) (joins hall_closet_trash trash closet)
    (belongs_to hall_closet_trash closet) (belongs_to hall_closet_trash trash)
    (joins hall_closet_office closet office) (joins hall_closet_office office closet)
    (belongs_to hall_closet_office closet) (belongs_to hall_closet_office office)
    (charger charger)

    (open hall_dining_office) (open hall_dining_kitchen)
    (open table) (open desk) (open bin) (open charger)
    (on bread0 pantry) (on snacks0 pantry) (on soda0 fridge) (on butter0 fridge) (on waste0 desk) (on waste1 bin)

    (= (battery robot) 100)
    (= (navigation_use) 4) (= (grasp_use) 10) (= (door_use) 11)
    (= (reserve) 20) (= (reserve_behind_doors) 90))

  (:goal (and
    (on waste0 dumpster) (on waste1 dumpster) (not (open dumpster))
    (on bread0 table) (on butter0 table) (not (open fridge)) (not (open pantry))
    (> (battery robot) 0))))
